"""A search for new places: when it begins, what it finds, when it ends."""

import math
from collections.abc import Iterable, Sequence
from typing import ClassVar

from msgspec import field

from clustermcl.belief.cluster_set import Cluster, ClusterSet
from clustermcl.belief.part import Count, Part
from clustermcl.belief.search_pool import Pool, SearchPool
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.job_events import Ended, EndedCause
from clustermcl.protocol.message import Circle, Corners, PoseTuple
from clustermcl.protocol.work import Job, Report, SearchJob, SearchReport

LOST_SEARCHES = 5
"""Searches are this many times as frequent while the robot is probably not on the map."""
KEPT_STEPS = 100
"""Largest number of steps by which a search may lag behind the clusters."""


class SearchCourse(Part):
    """The current search, if any, and where the clusters were at its steps."""

    local: ClassVar = frozenset({"settings", "means"})
    settings: FilterSettings = FilterSettings()
    mirrored: bool = False
    pool: SearchPool = field(default_factory=SearchPool)
    """The places that the current search has found."""
    begun: Count = 0
    next_step: int = 0
    """The step after which the next search is due."""
    means: dict[int, dict[str, PoseTuple]] = {}
    """Mean of each cluster at the last steps; by odometry where a report is missing."""

    @property
    def runs(self) -> bool:
        return bool(self.pool.job_ids)

    def is_due(self, step: int, patience: int) -> bool:
        """Return whether the next search may begin, `patience` steps after the last."""
        sooner = self.settings.belief.search_every_steps - patience
        return step >= self.next_step - sooner

    def is_due_for(self, step: int, held: ClusterSet) -> bool:
        """Return whether the next search for the robot may begin: at once if lost on this map."""
        patience = self.settings.belief.search_every_steps
        if held.is_lost:
            patience = 0 if held.is_elsewhere else patience // LOST_SEARCHES
        return not self.runs and self.is_due(step, patience)

    def is_over(self, pool: Pool, held: ClusterSet) -> bool:
        """Return whether the search is over (`SearchPool.finished`).

        One with more places than can be tracked may take longer, but not while the robot is
        probably off the map, or at clusters from before the search.
        """
        most = self.settings.belief.lost_probability
        before = [c.probability for c in held.all() if c.born_step < self.pool.first_step]
        patient = held.off_map <= most and math.fsum(before) <= most
        return self.pool.finished(pool, self.settings, patient=patient)

    def postpone(self, step: int) -> None:
        """Delay the next periodic search; a search for a lost robot may still begin."""
        self.next_step = max(self.next_step, step + 1)

    def begin(
        self, first_step: int, near: Circle | None = None, corners: Corners | None = None
    ) -> dict[str, Job]:
        """Begin a search, and return its jobs.

        Args:
            first_step: the first step whose scan it uses.
            near: circle to search; None: the whole map.
            corners: opposite ones of the rectangle to search; None: the whole map.
        """
        kind, shards = "m" if self.mirrored else "s", range(self.settings.search.shards)
        job_ids = tuple(f"{kind}{self.begun}.{shard}" for shard in shards)
        self.pool = SearchPool(job_ids, first_step)
        jobs: dict[str, Job] = {
            job_id: SearchJob(
                search=self.begun,
                shard=shard,
                first_step=first_step,
                near=near,
                corners=corners,
                mirrored=self.mirrored,
            )
            for shard, job_id in enumerate(job_ids)
        }
        self.begun += 1
        return jobs

    def stop(self, step: int, cause: EndedCause) -> list[Ended]:
        """End the search, if one is running; the next is due `search_every_steps` later."""
        ended = [Ended(job_id, cause) for job_id in self.pool.job_ids]
        self.pool = SearchPool()
        self.next_step = step + self.settings.belief.search_every_steps
        return ended

    def note_means(self, step: int, clusters: Iterable[Cluster]) -> None:
        self.means[step] = {cluster.job_id: cluster.pose for cluster in clusters}
        while len(self.means) > KEPT_STEPS:
            del self.means[next(iter(self.means))]

    def on_reports(self, reports: Sequence[Report], clusters: Sequence[str]) -> Pool | None:
        """Return the places that the search has found, if all shards have reported a new step.

        Args:
            reports: reports of all jobs.
            clusters: jobs of the clusters with which the places are compared.

        Returns:
            None: a shard has not reported a new step, or a cluster's mean at that step is unknown.
        """
        for report in reports:
            if isinstance(report, SearchReport) and report.job_id in self.pool.job_ids:
                self.pool.add(report)
        fresh = self.pool.pooled(self.settings.search)
        if fresh is None:
            return None
        then = self.means.get(fresh.step, {})
        return fresh if all(job_id in then for job_id in clusters) else None
