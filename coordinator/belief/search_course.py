"""Searches for new places and for a decoy: when they begin, what they find, when they end."""

import math
from collections.abc import Iterable, Mapping, Sequence

import msgspec
from msgspec.structs import replace

from coordinator.belief.cluster_set import Cluster
from coordinator.belief.search_evidence import KEPT_STEPS, SearchEvidence
from coordinator.belief.search_pool import Pool, SearchPool, SearchState
from particle_filter.settings import FilterSettings
from protocol.job_events import Ended, EndedCause
from protocol.message import Circle, Corners, PoseTuple
from protocol.work import Job, Report, SearchJob, SearchReport, TrackJob, TrackReport

LOST_SEARCHES = 5
"""Searches are this many times as frequent while the robot is probably not on the map."""

DECOYS = 3
"""Tracked places of the mirrored robot."""
SCANS = 4
"""Scans of one search for them."""
PATIENCE = 10
"""Steps from the end of a search for them to the next search."""


class SearchCourseState(msgspec.Struct, frozen=True):
    """What a checkpoint keeps of a `SearchCourse`."""

    search: SearchState | None
    searches: int
    next_search_step: int


class SearchCourse:
    """The current search, if any, and the evidence of the clusters since it began."""

    def __init__(self, settings: FilterSettings, *, mirrored: bool = False) -> None:
        self._settings, self._mirrored = settings, mirrored
        self._pool: SearchPool | None = None
        self.evidence = SearchEvidence()
        """Log-likelihoods of the clusters since the search began."""
        self.begun = 0
        """Number of searches begun."""
        self._next_step = 0
        self._means: dict[int, dict[str, PoseTuple]] = {}
        """Mean of each cluster at the last steps; by odometry where a report is missing."""

    @property
    def runs(self) -> bool:
        """Whether a search is running."""
        return self._pool is not None

    @property
    def job_ids(self) -> tuple[str, ...]:
        """The jobs of the current search, one for each shard."""
        return self._pool.job_ids if self._pool else ()

    @property
    def first_step(self) -> int:
        """The first step whose scan the search uses; 0: no search is running."""
        return self._pool.first_step if self._pool else 0

    @property
    def progress(self) -> float:
        """Progress of the search, 0 to 1; 0: no search is running."""
        return self._pool.progress if self._pool else 0.0

    def is_due(self, step: int, patience: int) -> bool:
        """Return whether the next search may begin, `patience` steps after the last."""
        sooner = self._settings.belief.search_every_steps - patience
        return step >= self._next_step - sooner

    def postpone(self, step: int) -> None:
        """Make the next search wait until after this step."""
        self._next_step = max(self._next_step, step + 1)

    def begin(
        self,
        first_step: int,
        log_elsewhere: float = 0.0,
        log_off_map: float = -math.inf,
        near: Circle | None = None,
        corners: Corners = (),
    ) -> dict[str, Job]:
        """Begin a search.

        Args:
            first_step: the first step whose scan it uses.
            log_elsewhere: log of the probability that the robot is elsewhere on the map.
            log_off_map: log of the probability that it is not on the map.
            near: where to look; None: everywhere.
            corners: of a region to search; empty: everywhere.

        Returns:
            The jobs of the search.
        """
        self._pool = self.new_pool(self.begun, first_step)
        jobs: dict[str, Job] = {
            job_id: SearchJob(
                search=self.begun,
                shard=shard,
                first_step=first_step,
                near=near,
                corners=corners,
                mirrored=self._mirrored,
            )
            for shard, job_id in enumerate(self._pool.job_ids)
        }
        self.begun += 1
        self.evidence = SearchEvidence(log_elsewhere, log_off_map)
        return jobs

    def stop(self, step: int, cause: EndedCause) -> list[Ended]:
        """End the search, if one is running; the next is due `search_every_steps` later."""
        ended = [Ended(job_id, cause) for job_id in self.job_ids]
        self._pool = None
        self._next_step = step + self._settings.belief.search_every_steps
        return ended

    def note_means(self, step: int, clusters: Iterable[Cluster]) -> None:
        """Record the means of the clusters after this step."""
        self._means[step] = {cluster.job_id: cluster.mean for cluster in clusters}
        while len(self._means) > KEPT_STEPS:
            del self._means[next(iter(self._means))]

    def means_at(self, step: int) -> Mapping[str, PoseTuple]:
        """Return the means of the clusters after a step, by job; empty for old steps."""
        return self._means.get(step, {})

    def hear(self, reports: Sequence[Report], clusters: Sequence[str]) -> Pool | None:
        """Return the places that the search has found, if all shards have reported a new step.

        Args:
            reports: of all jobs.
            clusters: jobs of the clusters that its places are compared with.

        Returns:
            None also where the mean of one of the clusters at that step is unknown.
        """
        if self._pool is None:
            return None
        for report in reports:
            if isinstance(report, SearchReport) and report.job_id in self.job_ids:
                self._pool.add(report)
        fresh = self._pool.pooled()
        if fresh is None:
            return None
        then = self.means_at(fresh.step)
        return fresh if all(job_id in then for job_id in clusters) else None

    def finished(self, pool: Pool, *, patient: bool) -> bool:
        """Return `SearchPool.finished` for the maximum number of clusters."""
        most = self._settings.belief.max_clusters
        return self._pool is None or self._pool.finished(pool, most, patient=patient)

    def new_pool(self, search: int, first_step: int) -> SearchPool:
        """Make the pool of a search of this course."""
        return SearchPool(search, first_step, self._settings.search, mirrored=self._mirrored)

    # --- checkpoint

    def state(self) -> SearchCourseState:
        """Return what a checkpoint keeps."""
        search = self._pool.state(_copied(self.evidence)) if self._pool else None
        return SearchCourseState(search, self.begun, self._next_step)

    def restore(self, state: SearchCourseState) -> None:
        """Continue from a checkpoint; the last reports have to arrive again."""
        self._pool = None
        self._means.clear()
        if (search := state.search) is not None:
            self._pool = self.new_pool(search.search, search.first_step)
            self._pool.progress = search.progress
            self.evidence = _copied(search.evidence)
        self.begun, self._next_step = state.searches, state.next_search_step


def _copied(evidence: SearchEvidence) -> SearchEvidence:
    return replace(evidence, gathered=dict(evidence.gathered))


class DecoyState(msgspec.Struct, frozen=True):
    """What a checkpoint keeps of a `Decoy`."""

    search: SearchCourseState
    places: tuple[Cluster, ...]


class Decoy:
    """Searches for a mirrored robot and tracks it (docs/unknown.md).

    A mirrored robot is not on the map, so its fit is the fit of a wrong place. The ensemble needs
    it only while it is uncertain whether the robot is on the map.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self._settings = settings
        self._search = SearchCourse(settings, mirrored=True)
        self.places: tuple[Cluster, ...] = ()
        """The tracked places of the decoy."""

    @property
    def search_ids(self) -> tuple[str, ...]:
        """The jobs of the current search for it."""
        return self._search.job_ids

    @property
    def is_awaited(self) -> bool:
        """Whether the first search for it is running."""
        return self._search.runs and not self.places

    @property
    def track_ids(self) -> tuple[str, ...]:
        """The jobs that track it."""
        return tuple(place.job_id for place in self.places)

    def best_of(self, reports: Mapping[str, TrackReport]) -> TrackReport | None:
        """Return the report of the decoy that the mirrored scan fits best; None: there is none."""
        found = [(place, reports.get(place.job_id)) for place in self.places]
        self.places = tuple(
            replace(place, mean=report.mean, covariance=report.covariance) if report else place
            for place, report in found
        )
        fits = [r for _, r in found if r and not math.isnan(r.log_likelihood_per_beam)]
        return max(fits, key=lambda report: report.log_likelihood_per_beam, default=None)

    def follow(
        self, step: int, reports: Sequence[Report], *, is_open: bool
    ) -> tuple[dict[str, Job], list[Ended]]:
        """Continue after a step.

        Args:
            step: its number.
            reports: of all jobs.
            is_open: whether it is uncertain that the robot is on the map.

        Returns:
            The jobs that begin, and those that end.
        """
        begin: dict[str, Job] = {}
        ended: list[Ended] = []
        pool = self._search.hear(reports, ())
        if pool is not None and pool.step - self._search.first_step + 1 >= SCANS:
            ended += self._end_tracking() + self._search.stop(step, "search over")
            first = (self._search.begun - 1) * DECOYS
            for index in range(min(len(pool.share), DECOYS)):
                found, number = pool.place(index, 1.0), first + index
                place = Cluster(number, 0.0, step, found.mean, found.covariance, mirrored=True)
                self.places += (place,)
                begin[place.job_id] = TrackJob(
                    cluster=number, start=found.sample, exact=False, mirrored=True
                )
        if not self._search.runs and self._search.is_due(step, PATIENCE):
            if is_open:
                begin |= self._search.begin(step + 1)
            else:
                ended += self._end_tracking()
        return begin, ended

    def stop(self, step: int) -> list[Ended]:
        """End all its jobs."""
        return self._end_tracking() + self._search.stop(step, "search stopped")

    def _end_tracking(self) -> list[Ended]:
        ended = [Ended(job_id, "search stopped") for job_id in self.track_ids]
        self.places = ()
        return ended

    def state(self) -> DecoyState:
        """Return what a checkpoint keeps."""
        return DecoyState(self._search.state(), self.places)

    def restore(self, state: DecoyState) -> None:
        """Continue from a checkpoint."""
        self._search.restore(state.search)
        self.places = state.places
