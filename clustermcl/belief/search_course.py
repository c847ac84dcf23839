"""Searches for new places and for a decoy: when they begin, what they find, when they end."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, ClassVar

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.belief.cluster_set import Cluster
from clustermcl.belief.explained import NO_PLACE, explains
from clustermcl.belief.part import FEW, Count, Part
from clustermcl.belief.search_pool import Pool, SearchPool
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.job_events import Ended, EndedCause
from clustermcl.protocol.message import Circle, Corners, PoseTuple
from clustermcl.protocol.work import Job, Report, SearchJob, SearchReport, TrackJob, TrackReport

LOST_SEARCHES = 5
"""Searches are this many times as frequent while the robot is probably not on the map."""

DECOYS = 3
"""Tracked places of the mirrored robot."""
SCANS = 4
"""Scans that a search for a decoy uses."""
PATIENCE = 10
"""Steps from the end of a search for a decoy to the next one."""
LEAST_REST = 1e-6
"""Least probability of the places of such a search that are not tracked."""
KEPT_STEPS = 100
"""Largest number of steps by which a search may lag behind the clusters."""


class SearchCourse(Part):
    """The current search, if any, and where the clusters were at its steps."""

    local: ClassVar = frozenset({"settings", "means"})
    settings: FilterSettings = FilterSettings()
    mirrored: bool = False
    pool: SearchPool | None = None
    """The places that the current search has found; None: no search is running."""
    begun: Count = 0
    next_step: int = 0
    """The step after which the next search is due."""
    means: dict[int, dict[str, PoseTuple]] = {}
    """Mean of each cluster at the last steps; by odometry where a report is missing."""

    @property
    def runs(self) -> bool:
        return self.pool is not None

    @property
    def job_ids(self) -> tuple[str, ...]:
        """The jobs of the current search, one for each shard."""
        return self.pool.job_ids if self.pool else ()

    @property
    def first_step(self) -> int:
        """The first step whose scan the search uses; 0: no search is running."""
        return self.pool.first_step if self.pool else 0

    @property
    def progress(self) -> float:
        """Progress of the search, 0 to 1; 0: no search is running."""
        return self.pool.progress if self.pool else 0.0

    def is_due(self, step: int, patience: int) -> bool:
        """Return whether the next search may begin, `patience` steps after the last."""
        sooner = self.settings.belief.search_every_steps - patience
        return step >= self.next_step - sooner

    def postpone(self, step: int) -> None:
        """Delay the next periodic search; a search for a lost robot may still begin."""
        self.next_step = max(self.next_step, step + 1)

    def begin(
        self,
        first_step: int,
        near: Circle | None = None,
        corners: Corners | None = None,
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
        ended = [Ended(job_id, cause) for job_id in self.job_ids]
        self.pool = None
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
        if self.pool is None:
            return None
        for report in reports:
            if isinstance(report, SearchReport) and report.job_id in self.job_ids:
                self.pool.add(report)
        fresh = self.pool.pooled(self.settings.search)
        if fresh is None:
            return None
        then = self.means.get(fresh.step, {})
        return fresh if all(job_id in then for job_id in clusters) else None


class Decoy(Part):
    """Searches for a mirrored robot and tracks it (docs/belief.md).

    A mirrored robot is not on the map, so its fit is the fit of a wrong place. The ensemble needs
    it only while it is uncertain whether the robot is on the map.
    """

    search: SearchCourse
    places: Annotated[tuple[Cluster, ...], FEW] = ()

    @property
    def track_ids(self) -> tuple[str, ...]:
        return tuple(place.job_id for place in self.places)

    def explains(
        self, reports: Mapping[str, TrackReport], beams: NDArray[np.float64], unit: float
    ) -> float | None:
        """Return the log evidence of a scan's new beams at the decoys; None: none has reported.

        It is averaged over all places of the decoy's search, of which those not tracked explain
        `NO_PLACE` of them. One that explains more counts more from then on.
        """
        found = [(place, reports.get(place.job_id)) for place in self.places]
        told = [(place, r, each) for place, r in found if r and (each := explains(r, beams))]
        if not told:
            return None
        rest = max(1.0 - math.fsum(place.probability for place, _, _ in told), LEAST_REST)
        of_rest = math.log(rest) + unit * NO_PLACE * float(beams.sum())
        weighed = np.array(
            [*(place.log_probability + unit * each.clear for place, _, each in told), of_rest]
        )
        mean = float(np.logaddexp.reduce(weighed))
        moved = {
            place.cluster: replace(place, pose=r.pose, covariance=r.covariance, log_probability=log)
            for (place, r, _), log in zip(told, (weighed[:-1] - mean).tolist(), strict=True)
        }
        self.places = tuple(moved.get(place.cluster, place) for place in self.places)
        return mean

    def follow(
        self, step: int, reports: Sequence[Report], *, is_open: bool
    ) -> tuple[dict[str, Job], list[Ended]]:
        """Begin and end the decoy's jobs after a step, and return them.

        `is_open`: it is uncertain whether the robot is on the map.
        """
        begin: dict[str, Job] = {}
        ended: list[Ended] = []
        pool = self.search.on_reports(reports, ())
        if pool is not None and pool.step - self.search.first_step + 1 >= SCANS:
            ended += self._end_tracking() + self.search.stop(step, "search over")
            first = (self.search.begun - 1) * DECOYS
            for index in range(min(len(pool.share), DECOYS)):
                found, number = pool.place(index, pool.share[index]), first + index
                place = Cluster(
                    number, math.log(found.share), step, found.pose, found.covariance, mirrored=True
                )
                self.places += (place,)
                begin[place.job_id] = TrackJob(
                    cluster=number, start=found.sample, exact=False, mirrored=True
                )
        if not self.search.runs and self.search.is_due(step, PATIENCE):
            if is_open:
                begin |= self.search.begin(step + 1)
            else:
                ended += self._end_tracking()
        return begin, ended

    def stop(self, step: int) -> list[Ended]:
        return self._end_tracking() + self.search.stop(step, "search stopped")

    def _end_tracking(self) -> list[Ended]:
        ended = [Ended(job_id, "search stopped") for job_id in self.track_ids]
        self.places = ()
        return ended
