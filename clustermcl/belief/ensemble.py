"""The belief of one robot and its search for new places.

The class has no clock, network or particles. It runs in the coordinator process and in
`clustermcl evaluate`, so both have the same beliefs bit for bit. Each decision takes effect at a
step number, so it does not depend on when a message arrives.
"""

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from msgspec.structs import replace

from clustermcl.belief.admission import Admission, admission, first_admission
from clustermcl.belief.bayes_update import OPEN, weigh
from clustermcl.belief.cluster_set import Candidate, ClusterSet, Given
from clustermcl.belief.decoy import Decoy
from clustermcl.belief.ledger import Ledger
from clustermcl.belief.links import is_in_cabin, ride
from clustermcl.belief.outcome import Outcome, hypothesis_of
from clustermcl.belief.part import Part
from clustermcl.belief.particle_shares import SHARE_AFTER_STEPS, particles_of, review_particles
from clustermcl.belief.search_course import SearchCourse
from clustermcl.belief.search_pool import pool_of
from clustermcl.filter.advice.view_memory import ViewMemory
from clustermcl.filter.arrays import Pose
from clustermcl.filter.cluster.cluster_filter import new_share
from clustermcl.filter.laser.evidence_model import UsualFit
from clustermcl.filter.laser.pieces import Pieces
from clustermcl.filter.poses import between
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.answers import Hypothesis, State
from clustermcl.protocol.found_places import FoundPlaces
from clustermcl.protocol.job_events import Ended, EndedCause, JobEvent
from clustermcl.protocol.message import Circle, Corners
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.why import Why
from clustermcl.protocol.work import (
    ElsewhereJob,
    ElsewhereReport,
    Job,
    Place,
    Report,
    TrackJob,
    TrackReport,
)

ELSEWHERE = "e0"
"""The job that weighs scans over the whole map; it starts again when steps or maps do."""


class Ensemble(Part, kw_only=True):
    """All clusters of one robot and the search for new ones (section 4)."""

    local: ClassVar = frozenset({"settings", "begin", "events"})
    settings: FilterSettings = FilterSettings()
    clusters: ClusterSet
    search: SearchCourse
    decoy: Decoy
    prior_pose: Place | None = None
    """A pose from an earlier run; it is used until the first search has ended."""
    seen: ViewMemory = ViewMemory()
    """What the places that it may be at have seen, for advice where to drive."""
    pieces: Pieces = Pieces()
    founding: bool = True
    """Whether no place has held since all were forgotten or a pose was given: nothing was lost."""
    begin: dict[str, Job] = {}
    events: list[JobEvent] = []

    @classmethod
    def of(cls, settings: FilterSettings) -> "Ensemble":
        return cls(
            settings=settings,
            clusters=ClusterSet(settings),
            search=SearchCourse(settings),
            decoy=Decoy(SearchCourse(settings, mirrored=True)),
        )

    def use(self, settings: FilterSettings) -> None:
        self.settings = self.clusters.settings = settings
        self.search.settings = self.decoy.search.settings = settings

    @property
    def searches(self) -> int:
        return self.search.begun

    @property
    def expected(self) -> tuple[str, ...]:
        """The jobs that have to report on the next step."""
        tracks = (*self.clusters.job_ids, *self.decoy.track_ids)
        return (*tracks, *self.search_ids, *self._elsewhere)

    @property
    def search_ids(self) -> tuple[str, ...]:
        return (*self.search.pool.job_ids, *self.decoy.search.pool.job_ids)

    @property
    def deferrable(self) -> tuple[str, ...]:
        """The expected jobs that may report later: searches, while clusters are tracked."""
        return self.search_ids if len(self.clusters) else ()

    def begin_at(self, step: int, prior_pose: Place | None = None) -> dict[str, Job]:
        """Start the first search, before the first step; return the jobs that process its scan."""
        self.prior_pose = prior_pose
        self.begin |= self.standing_jobs(step) | self.search.begin(step)
        begin, self.begin = self.begin, {}
        return begin

    def standing_jobs(self, first_step: int) -> dict[str, Job]:
        """Return the jobs that always run, from this step on."""
        return {job_id: ElsewhereJob(first_step=first_step) for job_id in self._elsewhere}

    def advance(
        self,
        step: int,
        reports: Sequence[Report],
        before_from_after: Pose | None = None,
        scan: Scan | None = None,
    ) -> Outcome:
        """Apply one step.

        Args:
            step: number of the step.
            reports: reports of this step that arrived in time, and reports of searches, which may
                belong to an earlier step.
            before_from_after: (3,) motion of the robot since the step before, by odometry; moves
                clusters without a report. None: unknown.
            scan: the step's scan, for the links of a building and `Scan.own_robot_found`; None:
                there are none.
        """
        was_lost, had_fallen = self.clusters.is_lost, self.clusters.fit_has_fallen
        was_elsewhere = self.clusters.is_elsewhere or not len(self.clusters)
        arrived = [report for report in reports if report.step == step]
        known = {report.job_id for report in arrived} | set(self.deferrable)  # searches may lag
        missing = tuple(job_id for job_id in self.expected if job_id not in known)
        tracks = {report.job_id: report for report in arrived if isinstance(report, TrackReport)}
        elsewhere = next((one for one in arrived if isinstance(one, ElsewhereReport)), None)
        observed = elsewhere.places if elsewhere else None
        news, seen = 1.0, ViewMemory.of_this_scan()
        if before_from_after is not None:
            seen = self.seen.after(before_from_after)
            if observed is None and all(cluster.confirmed for cluster in self.clusters.all()):
                news = new_share(before_from_after, self.settings.cluster)
        self.seen = seen
        in_cabin = scan is not None and is_in_cabin(scan, self.clusters)
        ledger = Ledger(self.clusters)
        self.pieces = self.pieces.moved(self._motion(tracks, before_from_after))
        self.clusters.follow(tracks)
        if in_cabin:
            self.pieces = Pieces()  # another floor has others
        else:
            self._weigh(tracks, elsewhere, news, ledger)
        if scan is not None and scan.floors.links:
            if entering := ride(self.clusters, scan, news, in_cabin=in_cabin):
                self._admit(entering, step)
            ledger.note("lifts and stairs")
        least = self.settings.belief.localized_probability
        is_sure = any(cluster.probability >= least for cluster in self.clusters.all())
        if scan is not None and scan.own_robot_found and not is_sure:
            return self.relocalize(step, "own robot found")
        if missing and before_from_after is not None:
            self.clusters.carry(missing, before_from_after)
        if observed is not None and len(self.clusters):
            self._admit_observed(observed, step)
            ledger.note("observed places")
        self.search.note_means(step, self.clusters.all())
        self.events += self.clusters.merge_overlaps()
        self.events += self.clusters.drop_improbable()
        ledger.note("places merged or dropped")
        review_particles(self.clusters, step)
        self._follow_search(step, reports)
        ledger.note("found by the search")
        self._follow_decoy(step, reports)
        if self.clusters.is_lost and not was_lost:
            self.seen = ViewMemory.of_this_scan()
        self._look_elsewhere(step, had_fallen=had_fallen, was_elsewhere=was_elsewhere)
        return self.outcome(step, missing, ledger)

    def set_pose(self, given: Place) -> Outcome:
        """Replace the belief by a pose that an operator gave, as AMCL does.

        Look-alikes do not enter beside it until scans speak against it, and a search begins.
        """
        self._forget(given.sample.step, "forgotten")
        self.founding = True
        self.clusters.expect_given()
        weight = given.share / (1.0 - given.share)
        self._admit([(replace(given, share=weight), "given")], given.sample.step)
        return self.outcome(given.sample.step)

    def relocalize(
        self,
        step: int,
        cause: EndedCause = "forgotten",
        near: Circle | None = None,
        corners: Corners | None = None,
    ) -> Outcome:
        """Forget all clusters and search from the next step on.

        Later searches always cover the whole map.

        Args:
            step: number of the last step.
            cause: reason for the end of the clusters.
            near: circle to search first; None: the whole map.
            corners: opposite ones of the rectangle to search first; None: the whole map.
        """
        self._forget(step, cause)
        self.founding = True
        self.begin |= self.search.begin(step + 1, near, corners)
        return self.outcome(step)

    def continue_from(self, places: Sequence[Place], step: int, cause: EndedCause) -> Outcome:
        """Replace all clusters by these places; elsewhere has what their shares leave."""
        self._forget(step, cause)
        self.clusters.take_from_elsewhere(min(math.fsum(place.share for place in places), 1.0))
        self._admit([(place, "prior pose") for place in places], step)
        return self.outcome(step)

    # --- clusters

    def _motion(self, tracks: Mapping[str, TrackReport], before_from_after: Pose | None) -> Pose:
        """Return the motion of the most probable place: its scans correct odometry."""
        if before_from_after is None:
            return np.zeros(3)
        best = next(iter(self.clusters.by_probability()), None)
        if best is None or best.job_id not in tracks:
            return before_from_after
        return between(np.array(best.pose), np.array(tracks[best.job_id].pose))

    def _weigh(
        self,
        tracks: Mapping[str, TrackReport],
        elsewhere: ElsewhereReport | None,
        news: float,
        ledger: Ledger,
    ) -> None:
        beams, unseen, decoy = None, None, None
        if elsewhere is not None and elsewhere.seen is not None:
            beams, share, self.pieces = self.pieces.after(elsewhere.seen.array())
            unseen = share if self.clusters.rules.piece_evidence else None
            decoy = self.decoy.explains(tracks, beams, self.clusters)
        weigh(
            self.clusters,
            tracks,
            elsewhere,
            beams=beams,
            news=news,
            unseen=unseen,
            decoy=decoy,
            ledger=ledger,
        )

    # --- the search

    def _look_elsewhere(self, step: int, *, had_fallen: bool, was_elsewhere: bool) -> None:
        """Begin a search if one is due, scans fit worse than usual, or a given pose fails."""
        given, fell = self.clusters.given, self.clusters.fit_has_fallen and not had_fallen
        if given is not None and not (given.is_doubted or fell or self.clusters.is_lost):
            return
        self.clusters.given = None
        lifted = self.clusters.is_elsewhere and not was_elsewhere and not self.founding
        is_due = self.search.is_due_for(step, self.clusters)
        if given is not None or lifted or fell or is_due:
            self.events += self.search.stop(step, "search stopped")
            self.begin |= self.search.begin(step + 1)

    def _forget(self, step: int, cause: EndedCause) -> None:
        """End all clusters and the decoy: the robot may be anywhere."""
        self.events += [*self.clusters.clear(cause), *self.decoy.stop(step)]
        self.prior_pose, self.seen, self.pieces = None, ViewMemory(), Pieces()
        self.events += self.search.stop(step, "search stopped")
        self.begin |= self.standing_jobs(step + 1)

    def _follow_search(self, step: int, reports: Sequence[Report]) -> None:
        fresh = self.search.on_reports(reports, self.clusters.job_ids)
        if fresh is None:
            return
        is_over = self.search.is_over(fresh, self.clusters)
        if len(self.clusters):
            then, first_step = self.search.means[fresh.step], self.search.pool.first_step
            found = admission(fresh, self.clusters, then, first_step, "restart", is_over=is_over)
        else:
            found = first_admission(fresh, self.prior_pose, self.clusters)
            self.prior_pose = None if found.entering else self.prior_pose
        self._admit_found(found, step)
        if is_over:
            self.events += self.search.stop(step, "search over")
            self.founding &= self.clusters.is_elsewhere
            self.clusters.fit = UsualFit()  # it has found nothing better, so this is usual now
            if self.clusters.on_map and self.clusters.oldest_holds:
                self.clusters.given = Given(searched=True)

    def _follow_decoy(self, step: int, reports: Sequence[Report]) -> None:
        begin, ended = self.decoy.follow(step, reports, is_open=self.clusters.off_map > OPEN)
        self.begin |= begin
        self.events += ended

    def _admit_observed(self, observed: FoundPlaces, step: int) -> None:
        """Admit places that an observation allows."""
        pool = pool_of(step, [observed], np.ones(1), self.settings.search)
        now = {cluster.job_id: cluster.pose for cluster in self.clusters.all()}
        self._admit_found(admission(pool, self.clusters, now, step + 1, "observed"), step)

    def _admit_found(self, found: Admission, step: int) -> None:
        found.make_way(self.clusters)
        self._admit(found.entering, step)

    def _admit(self, candidates: Sequence[Candidate], step: int) -> None:
        if candidates and len(self.clusters):
            self.seen = ViewMemory.of_this_scan()  # further scans separate others, not these
        admitted, events = self.clusters.admit(candidates, step)
        self.events += events
        for (place, _), cluster in zip(candidates, admitted, strict=True):
            particles = particles_of(cluster, self.clusters)
            self.clusters.change(cluster, particles=particles)
            self.begin[cluster.job_id] = TrackJob(
                cluster=cluster.cluster, start=place.sample, exact=False, particles=particles
            )

    # --- outcome

    def outcome(
        self, step: int, missing: tuple[str, ...] = (), ledger: Ledger | None = None
    ) -> Outcome:
        """Return the outcome of a step or a command; jobs and events only at the first call."""
        is_confirmed = any(cluster.confirmed for cluster in self.clusters.all())
        most = self.settings.belief.lost_probability
        self.founding &= not is_confirmed or self.clusters.outside_clusters > most
        events, self.events = tuple(self.events), []
        ended = {event.job_id for event in events if isinstance(event, Ended)}
        begin = {job_id: job for job_id, job in self.begin.items() if job_id not in ended}
        self.begin = {}
        *near, log_elsewhere, _ = self.clusters.near().tolist()
        each = zip(self.clusters.all(), near, strict=True)
        tracked = [hypothesis_of(cluster, log_near, step) for cluster, log_near in each]
        tracked.sort(key=lambda place: (-place.log_probability, place.cluster))
        return Outcome(
            step=step,
            state=self._state(tracked),
            hypotheses=tuple(tracked),
            elsewhere_probability=math.exp(log_elsewhere) + self.clusters.off_map,
            off_map_probability=self.clusters.off_map,
            searching=self.search.runs,
            missing=missing,
            begin=begin,
            resize={
                c.job_id: (c.particles, c.particles_from)
                for c in self.clusters.all()
                if c.particles and c.particles_from == step + SHARE_AFTER_STEPS
            },
            events=events,
            search_progress=self.search.pool.progress,
            why=ledger.why([place.cluster for place in tracked]) if ledger else Why(),
        )

    def _state(self, hypotheses: Sequence[Hypothesis]) -> State:
        if not len(self.clusters):
            return "searching"
        if self.clusters.is_lost:  # while the first search runs, nothing was lost
            return "searching" if self.founding else "lost"
        if not self.clusters.by_probability()[0].confirmed:
            return "searching"
        sure = hypotheses[0].probability >= self.settings.belief.localized_probability
        return "localized" if sure else "ambiguous"

    @property
    def _elsewhere(self) -> tuple[str, ...]:
        """The job that weighs scans over the whole map; empty if a kidnapping is impossible."""
        return (ELSEWHERE,) if self.settings.belief.kidnapping_probability > 0.0 else ()
