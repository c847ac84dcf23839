"""The belief and the search for new places: told of steps, answers with jobs.

A plain object without clock, network or particles. The same object runs in the coordinator
process and in `clustermcl evaluate`, so that both believe the same, bit for bit. All that it
decides takes effect at a step number, never on arrival.
"""

import math
from collections.abc import Iterable, Sequence

import msgspec
from msgspec.structs import replace

from coordinator.belief.admission import newcomers, terms
from coordinator.belief.cluster_set import Cluster, ClusterSet, Newcomer
from coordinator.belief.fit_monitor import FitMonitor, FitState
from coordinator.belief.outcome import Job, Outcome, hypothesis_of, places_of
from coordinator.belief.prior_pose import PriorPose, with_prior_pose
from coordinator.belief.search_pool import Pool, SearchPool, SearchState
from particle_filter.arrays import Pose
from particle_filter.settings import FilterSettings
from protocol.answers import Hypothesis, State
from protocol.job_events import Ended, EndedCause, JobEvent
from protocol.message import PoseTuple
from protocol.work import Place, Report, SearchJob, SearchReport, TrackJob, TrackReport

KEPT_MEANS = 100
"""Steps that a search may lie behind the clusters it is compared with."""


class EnsembleState(msgspec.Struct, frozen=True):
    """The belief and the search for new places."""

    clusters: tuple[Cluster, ...]
    """In the order in which they are summed."""
    next_cluster: int
    fit: FitState
    search: SearchState | None
    searches: int
    next_search_step: int
    prior_pose: PriorPose | None = None


class Ensemble:
    """All clusters of one robot and the search for new ones (section 4)."""

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self.clusters = ClusterSet(settings.belief)
        self._fit = FitMonitor(settings.belief)
        self._search: SearchPool | None = None
        self._possible: tuple[Hypothesis, ...] = ()
        """What the search holds possible, until there are clusters."""
        self._prior_pose: PriorPose | None = None
        self.searches = 0
        """How many have begun."""
        self._next_search_step = 0
        self._begin: dict[str, Job] = {}
        self._events: list[JobEvent] = []
        self._means: dict[int, dict[str, PoseTuple]] = {}
        """Where the clusters that reported were at the last steps."""

    @property
    def expected(self) -> tuple[str, ...]:
        """Jobs whose report on the next step is waited for."""
        return (*self.clusters.job_ids, *(self._search.job_ids if self._search else ()))

    def begin_at(self, step: int, prior_pose: PriorPose | None = None) -> dict[str, Job]:
        """What must see the scan of `step` itself: the first search. Call once, before it.

        Args:
            step: the first one.
            prior_pose: a place that is possible from earlier knowledge.
        """
        self._prior_pose = prior_pose
        self._start_search(step)
        begin, self._begin = self._begin, {}
        return begin

    def advance(
        self, step: int, reports: Sequence[Report], before_from_after: Pose | None = None
    ) -> Outcome:
        """Apply one step.

        Args:
            step: its number.
            reports: those of this step that arrived in time, others are missing; and those of
                searches, which may be of an earlier step.
            before_from_after: (3,) how the robot moved since the step before, by odometry; it
                carries clusters without a report. None: it is not known.
        """
        arrived = {report.job_id for report in reports if report.step == step}
        missing = tuple(job_id for job_id in self.expected if job_id not in arrived)
        tracks = {r.job_id: r for r in reports if isinstance(r, TrackReport) and r.step == step}
        self.clusters.weigh(tracks)
        if missing and before_from_after is not None:
            self.clusters.carry(missing, before_from_after, self.settings.motion)
        self._note_means(step, tracks.values())
        self._fit.update(
            max((r.log_likelihood_per_beam for r in tracks.values()), default=math.nan)
        )
        if step % self.settings.belief.merge_every_steps == 0:
            self._events += self.clusters.merge_overlaps()
        self._split(tracks.values(), step)
        self._events += self.clusters.drop_improbable(step)
        self._follow_search(step, reports)
        if self._search is None and (self._fit.lost or step >= self._next_search_step):
            self._start_search(step + 1)
        return self._outcome(step, missing)

    def postpone_search(self, step: int) -> None:
        """Let no periodic search begin after this step; one for a robot that is lost may."""
        self._next_search_step = max(self._next_search_step, step + 1)

    def set_pose(self, given: Place) -> Outcome:
        """Believe a person: a cluster at the given pose takes its share from the others."""
        step = given.sample.step
        self._stop_search(step, "search stopped")
        if not len(self.clusters):
            given = replace(given, share=1.0)
        self._admit([(given, "given")], step)
        self._prior_pose = None
        self._fit.forget()
        return self._outcome(step, ())

    def relocalize(self, step: int, cause: EndedCause = "forgotten") -> Outcome:
        """Forget all clusters and search everywhere from the next step on.

        Args:
            step: the last one.
            cause: why the clusters end.
        """
        self._events += self.clusters.clear(cause)
        self._stop_search(step, "search stopped")
        self._prior_pose = None
        self._fit.forget()
        self._start_search(step + 1)
        return self._outcome(step, ())

    # --- handed on

    def state(self) -> EnsembleState:
        """All that decides; ask for it between steps."""
        return EnsembleState(
            clusters=self.clusters.all(),
            next_cluster=self.clusters.next_cluster,
            fit=self._fit.state(),
            search=self._search.state(self._possible) if self._search else None,
            searches=self.searches,
            next_search_step=self._next_search_step,
            prior_pose=self._prior_pose,
        )

    def restore(self, state: EnsembleState) -> None:
        """Go on from where another was; of a search, the last reports must be given again."""
        self.clusters.restore(state.clusters, state.next_cluster)
        self._fit.restore(state.fit)
        self._search, self._possible = None, ()
        self._means.clear()
        if (search := state.search) is not None:
            self._search = SearchPool(search.search, search.first_step, self.settings.search)
            self._possible = search.possible
        self.searches, self._next_search_step = state.searches, state.next_search_step
        self._prior_pose = state.prior_pose

    def again(self, step: int, missing: tuple[str, ...]) -> Outcome:
        """What the last step came to, without the jobs that it began or ended, and why."""
        return self._outcome(step, missing)

    # --- clusters

    def _split(self, reports: Iterable[TrackReport], step: int) -> None:
        """A cluster that has fallen apart becomes several, which share its probability."""
        for report in reports:
            if not report.parts or report.job_id not in self.clusters.job_ids:
                continue
            self._track(report.parts, *self.clusters.split(report.job_id, report.parts, step))

    # --- the search

    def _start_search(self, first_step: int) -> None:
        search = SearchPool(self.searches, first_step, self.settings.search)
        for shard, job_id in enumerate(search.job_ids):
            job = SearchJob(search=self.searches, shard=shard, first_step=first_step)
            self._begin[job_id] = job
        self.searches += 1
        self._search, self._possible = search, ()

    def _stop_search(self, step: int, cause: EndedCause) -> None:
        if self._search is not None:
            self._events += [Ended(job_id, cause) for job_id in self._search.job_ids]
        self._search, self._possible = None, ()
        self._next_search_step = step + self.settings.belief.search_every_steps

    def _note_means(self, step: int, reports: Iterable[TrackReport]) -> None:
        self._means[step] = {report.job_id: report.mean for report in reports}
        while len(self._means) > KEPT_MEANS:
            del self._means[next(iter(self._means))]

    def _follow_search(self, step: int, reports: Sequence[Report]) -> None:
        if self._search is None:
            return
        for report in reports:
            if isinstance(report, SearchReport) and report.job_id in self._search.job_ids:
                self._search.add(report)
        fresh = self._search.pooled()
        if fresh and not len(self.clusters):
            self._possible = places_of(fresh)
        if fresh and self._search.finished(fresh, self.settings.belief.clusters):
            then = self._means.get(fresh.step, {})
            if any(job_id not in then for job_id in self.clusters.job_ids):
                return  # it goes on until it can be told who is new
            if len(self.clusters):
                held = [then[job_id] for job_id in self.clusters.job_ids]
                self._admit_newcomers(fresh, step, held)
            else:
                self._admit_first(fresh, self._search, step)
            self._stop_search(step, "search over")

    def _admit_first(self, pool: Pool, search: SearchPool, step: int) -> None:
        """The K most probable places, by their share of points (section 4).

        Scans tell no more against a place while it is searched for than once it is tracked:
        `evidence_bound` a step. A share is far noisier than that: a place whose first points
        happened to lie well gets a hundred times those of another just like it.
        """
        kept = pool.places[: self.settings.belief.clusters]
        steps = pool.step - search.first_step + 1
        least = math.exp(-self.settings.belief.evidence_bound * steps)
        shares = [max(place.share, kept[0].share * least) for place in kept]
        total = math.fsum(shares)
        first = [replace(p, share=share / total) for p, share in zip(kept, shares, strict=True)]
        newcomers: list[Newcomer] = [(place, "first search") for place in first]
        if self._prior_pose is not None and kept:
            odom_from_robot = kept[0].sample.odom_from_robot
            newcomers = with_prior_pose(first, self._prior_pose, odom_from_robot, self.settings)
        self._prior_pose = None
        self._admit(newcomers, step)

    def _admit_newcomers(self, pool: Pool, step: int, held: Sequence[PoseTuple]) -> None:
        """The best places of a restart that no cluster holds enter with a small probability.

        Args:
            pool: what the search has found.
            step: the step after which they are tracked.
            held: where the clusters were at the step of the pool.
        """
        rules, yielding = self.settings.belief, self.clusters.yielding(step)
        given, best = terms(pool, self._fit, rules), self.clusters.by_probability()[0].probability
        found = newcomers(pool, held, yielding, best, given, self.settings)
        entering: list[Newcomer] = [(place, "restart") for place in found]
        if entering:
            self._admit(entering, step, protected_until=step + rules.grace_steps)

    def _admit(
        self, newcomers: Sequence[Newcomer], step: int, *, protected_until: int = -1
    ) -> None:
        admitted = self.clusters.admit(newcomers, step, protected_until=protected_until)
        self._track([place for place, _ in newcomers], *admitted)

    def _track(
        self, places: Iterable[Place], clusters: Iterable[Cluster], events: Iterable[JobEvent]
    ) -> None:
        """Begin the jobs of new clusters, each from its place's sample."""
        for place, cluster in zip(places, clusters, strict=True):
            job = TrackJob(cluster=cluster.cluster, start=place.sample, exact=False)
            self._begin[cluster.job_id] = job
        self._events += events

    # --- what it comes to

    def _outcome(self, step: int, missing: tuple[str, ...]) -> Outcome:
        begin, self._begin = self._begin, {}
        events, self._events = tuple(self._events), []
        tracked = tuple(hypothesis_of(c, step) for c in self.clusters.by_probability())
        hypotheses = tracked or self._possible
        return Outcome(
            step=step,
            state=self._state(hypotheses),
            hypotheses=hypotheses,
            searching=self._search is not None,
            missing=missing,
            begin=begin,
            events=events,
        )

    def _state(self, hypotheses: tuple[Hypothesis, ...]) -> State:
        if not len(self.clusters):
            return "searching"
        if self._fit.lost:
            return "lost"
        sure = hypotheses[0].probability >= self.settings.belief.localized_probability
        return "localized" if sure else "ambiguous"
