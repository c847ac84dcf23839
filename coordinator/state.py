"""The state of a coordinator: the belief, the jobs, the open steps, and the commands.

All parts that affect decisions can be transferred from one coordinator to its successor.
"""

from collections.abc import Iterable
from functools import partial
from statistics import median

import numpy as np
from msgspec import field
from msgspec.structs import replace

from coordinator.belief.cluster_set import Cluster
from coordinator.belief.ensemble import Ensemble
from coordinator.belief.given_places import candidate
from coordinator.belief.outcome import Outcome
from coordinator.belief.prior_pose import PriorPose
from coordinator.checkpoint import (
    MAX_AGE_S,
    STATE_VERSION,
    CheckpointState,
    state_in,
)
from coordinator.commands import Commands
from coordinator.dead_reckoning import carried
from coordinator.free_ground import FreeGround
from coordinator.part import Part
from coordinator.placement import Placement
from coordinator.pose_tracker import PoseTracker
from coordinator.step_collector import ReadyStep, StepCollector
from particle_filter.arrays import Pose
from particle_filter.poses import between
from particle_filter.random_streams import Purpose
from particle_filter.settings import FilterSettings, filter_with, section_with
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from protocol.answers import Relocalize, SetPose
from protocol.job_events import EndedCause, JobEvent, NumberedEvent
from protocol.live_settings import AS_STARTED, LiveSettings
from protocol.message import Covariance, PoseTuple
from protocol.steps import Scan, mirrored
from protocol.work import Checkpoint, Place, Report, TrackJob

STEPS = 20
"""A worker that dies delays a few steps; an overload delays most of this number."""
LATE_NS, IN_TIME_NS = 100_000_000, 50_000_000
"""From its scan to its decision half of the steps take longer; and again no longer than that."""


class OverloadDetector(Part):
    """Detects from the waiting times of steps that the machine is overloaded."""

    waits_ns: list[int] = []
    is_overloaded: bool = False
    """Whether work that is not urgent is postponed."""

    def step_decided(self, waited_ns: int) -> None:
        """Take how long a step has waited from its scan to its decision [ns]."""
        self.waits_ns = [*self.waits_ns, waited_ns][-STEPS:]
        if len(self.waits_ns) == STEPS:
            bound_ns = IN_TIME_NS if self.is_overloaded else LATE_NS
            self.is_overloaded = median(self.waits_ns) > bound_ns


NEEDED = 3
"""So many scans of the other map in a row, and none of ours between: one alone may be anything."""


class MapChangeDetector(Part):
    """Detects that the bridge was restarted with another map.

    A second bridge of the same robot, or a stray message, is ignored, because scans of the present
    map arrive in between. A bridge that waits for a belief repeats its scan, and repetitions count.
    """

    digest: str = ""
    """Digest of the other map."""
    step: int = -1
    in_a_row: int = 0

    def is_another(self, scan: Scan, ours: str) -> bool:
        """Take a scan.

        Args:
            scan: any that arrives.
            ours: digest of the map in which the robot is looked for.
        """
        if scan.map_digest == ours:
            self.in_a_row = 0
            return False
        follows = scan.map_digest == self.digest and scan.step >= self.step
        self.in_a_row = self.in_a_row + 1 if follows else 1
        self.digest, self.step = scan.map_digest, scan.step
        return self.in_a_row >= NEEDED


KEPT_EVENTS = 200


class EventLog(Part):
    """The last events of one coordinator; its successor begins with none."""

    kept: list[NumberedEvent] = []
    count: int = 0
    unpublished: list[NumberedEvent] = []

    def add(self, events: Iterable[JobEvent], step: int, stamp_ns: int) -> None:
        """Number and keep the events of a step or a command.

        Args:
            events: in the order in which they were decided.
            step: step after which the events hold.
            stamp_ns: robot's clock at the scan of the step [ns].
        """
        for event in events:
            numbered = NumberedEvent(number=self.count, step=step, stamp_ns=stamp_ns, event=event)
            self.count += 1
            self.kept.append(numbered)
            self.unpublished.append(numbered)
        del self.kept[:-KEPT_EVENTS]

    def news(self) -> tuple[NumberedEvent, ...]:
        """Return the events since the last call."""
        news, self.unpublished = tuple(self.unpublished), []
        return news


ASK_MAP_AGAIN_NS = 2_000_000_000


class CoordinatorState(Part):
    """The belief, the jobs, the open steps and the commands of one robot."""

    filter_settings: FilterSettings
    """The filter's settings at the start."""
    settings: CoordinatorSettings
    bridge: BridgeSettings
    """The bridge's settings at the start."""
    ensemble: Ensemble
    placement: Placement
    collector: StepCollector
    pose: PoseTracker
    live: LiveSettings = AS_STARTED
    """The settings that hold at the applied step, in place of those of the start."""
    event_log: EventLog = field(default_factory=EventLog)
    commands: Commands = field(default_factory=Commands)
    outcome: Outcome | None = None
    """Result of the last step or command."""
    counters: dict[str, int] = {}
    """Number of events by cause."""
    steps_applied: int = 0
    reports_missing: int = 0
    overload: OverloadDetector = field(default_factory=OverloadDetector)
    map_digest: str = ""
    """Digest of the map in which the robot is localized; empty before the first scan."""
    map_changes: MapChangeDetector = field(default_factory=MapChangeDetector)
    ground: FreeGround | None = None
    """Free ground of the last map that has arrived."""
    map_asked_ns: int | None = None
    """When the map was requested last [ns]."""
    founded: bool = False
    """Whether the belief has had clusters, or a command has been carried out."""
    changed: bool = True
    """Whether the state has to be published before anything that follows from it."""

    @classmethod
    def of(
        cls,
        sender: str,
        filter_settings: FilterSettings,
        settings: CoordinatorSettings,
        bridge: BridgeSettings,
    ) -> "CoordinatorState":
        """Return an initial state: no clusters, workers or steps."""
        return cls(
            filter_settings,
            settings,
            bridge,
            Ensemble.of(filter_settings),
            Placement.of(sender, filter_settings, settings.snapshot_every_steps),
            StepCollector(settings),
            PoseTracker.of(sender, settings, filter_settings.motion, bridge),
        )

    def count(self, cause: str, times: int = 1) -> None:
        """Count events of a cause."""
        self.counters[cause] = self.counters.get(cause, 0) + times

    @property
    def newest_step(self) -> int:
        """The newest whose scan has arrived, applied or not; -1: none."""
        known = (self.collector.newest_scan, self.collector.applied)
        return max((scan.step for scan in known if scan is not None), default=-1)

    def _use(self, live: LiveSettings) -> None:
        """Continue with the settings of a scan."""
        if live != self.live:
            self.live = live
            settings = filter_with(self.filter_settings, live)
            self.ensemble.use(settings)
            self.pose.use(settings.motion, section_with(self.bridge, live))

    @property
    def newest_settings(self) -> LiveSettings:
        """The settings of the newest scan that has arrived."""
        newest = self.collector.newest_scan
        return newest.settings if newest is not None else self.live

    def place_counts(self, was_live: bool) -> bool:
        """Return whether the robot may still be where it was when the system last ran.

        A recording or a simulation begins where it begins, unless a person names a folder for it.
        """
        return (was_live and self.pose.live) or bool(self.settings.state_folder)

    # --- what happens

    def on_map(self, scan: Scan) -> bool:
        """Take a scan's map; return False for another map than that of the first scan.

        Where the bridge has another map for certain, that one counts from this scan on.
        """
        self.map_digest = self.map_digest or scan.map_digest
        if self.map_changes.is_another(scan, self.map_digest):
            self._change_map(scan)
        if scan.map_digest != self.map_digest:
            self.count("scan of another map")
        return scan.map_digest == self.map_digest

    @property
    def _free_ground(self) -> FreeGround | None:
        known = self.ground
        return known if known and known.map_digest == self.map_digest else None

    def wants_map(self, now_ns: int) -> bool:
        """Return whether to request the map now: given poses are checked with it."""
        asked_ns = self.map_asked_ns
        if not self.map_digest or self._free_ground is not None:
            return False
        if asked_ns is not None and now_ns - asked_ns < ASK_MAP_AGAIN_NS:
            return False
        self.map_asked_ns = now_ns
        return True

    def on_map_arrived(self, ground: FreeGround) -> bool:
        """Take the map's free ground; return whether a given pose that waited was applied."""
        self.ground = ground
        applied = self.collector.applied
        return applied is not None and self._carry_out_waiting(applied)

    def on_worker_joined(self, worker: str, silent_until_ns: int) -> None:
        """Add a worker, which gets no orders for a while."""
        self.placement.joined(worker, silent_until_ns)
        self.changed = True

    def on_worker_left(self, worker: str) -> None:
        self.placement.left(worker)
        self.changed = True

    def on_report(self, report: Report, worker: str, *, is_told_late: bool = False) -> None:
        """Process a worker's report, unless another worker has the job.

        Args:
            report: the report as received.
            worker: name of the worker.
            is_told_late: see `StepCollector.has_room_for`.
        """
        jobs = self.placement.jobs
        if jobs.is_of_another(report.job_id, report.epoch, worker):
            self.count("report of another worker's job")
            return
        if not jobs.is_current(report.job_id, report.epoch):
            self.count("report of an old epoch")
            return
        if not self.collector.has_room_for(report, is_told_late=is_told_late):
            self.count("report far ahead, or beside too many")
            return
        in_time = self.collector.on_report(report)
        self.placement.reported(report, in_time=in_time)
        if not in_time:
            self.count("report late")

    def begin_search(self, first_step: int, prior_pose: PriorPose | None) -> None:
        self.collector.begin_after(first_step - 1)
        self.placement.jobs.begin(self.ensemble.begin_at(first_step, prior_pose))
        self.changed = True

    @property
    def awaits_reports(self) -> bool:
        """Whether no step can be applied now: none is open, or a report is missing."""
        reports = self.collector.oldest_reports
        unhurried = self.ensemble.unhurried if self.collector.waits_for_no_search else ()
        return reports is None or any(
            job_id not in reports and job_id not in unhurried and self.placement.waits_for(job_id)
            for job_id in self.ensemble.expected
        )

    def ready(self, now_ns: int) -> ReadyStep | None:
        """Return the next step if it is due, which must be applied then; else None."""
        if self.collector.oldest_scan is None:
            return None
        expected = self.placement.waited_for(self.ensemble.expected)
        placed_ns, unhurried = self.placement.jobs.placed_ns, self.ensemble.unhurried
        return self.collector.ready(expected, placed_ns, now_ns, unhurried)

    def apply(self, ready: ReadyStep, now_ns: int) -> None:
        """Decide a step."""
        self._use(ready.scan.settings)
        self._notice_overload(ready, now_ns)
        expected = self.ensemble.expected
        weighing = self.ensemble.clusters.job_ids or expected
        outcome = self.ensemble.advance(ready.scan.step, ready.reports, _moved(ready))
        patient = self.overload.is_overloaded
        self.placement.step_decided(expected, outcome.missing, now_ns, patient=patient)
        self.placement.jobs.step_applied(ready.scan.step)
        self.steps_applied += 1
        self.reports_missing += len(outcome.missing)
        if not outcome.missing or set(weighing) - set(outcome.missing):
            self.pose.weighed(ready.scan.stamp_ns, ready.scan.odom_from_robot)
        self._follow(outcome, ready.scan)
        self._carry_out_waiting(ready.scan)

    def _carry_out_waiting(self, applied: Scan) -> bool:
        history, ground = self.pose.history, self._free_ground
        given = self.commands.carry_out_waiting(self.ensemble, applied, history, ground)
        if isinstance(given, str):
            self.count("pose off the map refused")
        elif given is not None:
            self.founded = True
            self._follow(given, applied)
            return True
        return False

    def _notice_overload(self, ready: ReadyStep, now_ns: int) -> None:
        """Postpone periodic searches while the machine is overloaded.

        A search takes its time, and a recording that waits for each belief has it.
        """
        if ready.scan.lockstep or (self.outcome is not None and self.outcome.searching):
            return
        self.overload.step_decided(now_ns - ready.arrived_ns)
        if self.overload.is_overloaded:
            self.ensemble.postpone_search(ready.scan.step)

    def carry_out(self, command: SetPose | Relocalize) -> bool:
        """Carry out a command; return False if it waits for the first step or is refused."""
        applied = self.collector.applied
        history, self.changed = self.pose.history, True
        ground = self._free_ground
        outcome = self.commands.carry_out(command, self.ensemble, applied, history, ground)
        if outcome is None or applied is None:
            return False
        self.founded = True
        self._follow(outcome, applied)
        return True

    def count_anew(self, scan: Scan) -> None:
        """Search for the robot: the bridge was restarted, and steps and odometry begin again."""
        self.count("steps counted anew")
        self._begin_anew(scan, "steps restarted")

    def _change_map(self, scan: Scan) -> None:
        """Change to the bridge's new map: keep the places if so configured, or search again."""
        self.count("map changed")
        self.map_digest = scan.map_digest
        applied = self.collector.applied
        if not (self.settings.keep_pose_on_new_map and applied and len(self.ensemble.clusters)):
            self._begin_anew(scan, "new map")
            return
        places = [self._in_new_map(c, applied, scan) for c in self.ensemble.clusters.all()]
        self.collector.restart(scan.step - 1, replace(scan, step=scan.step - 1))
        self._follow(self.ensemble.go_on_from(places, scan.step - 1, "new map"), scan)

    def _in_new_map(self, cluster: Cluster, applied: Scan, scan: Scan) -> Place:
        """Return a cluster's place just before the first scan of another map."""
        mean, covariance = carried(
            cluster.mean,
            cluster.covariance,
            applied.odom_from_robot,
            scan.odom_from_robot,
            self.ensemble.settings.motion,
        )
        return self._drawn_anew(
            cluster.cluster, cluster.probability, mean, covariance, scan, scan.step - 1
        )

    def _begin_anew(self, scan: Scan, cause: EndedCause) -> None:
        """Forget all places; if a search has begun before, begin one from this scan on."""
        self.collector.restart(scan.step - 1)
        if self.ensemble.searches:
            self._follow(self.ensemble.relocalize(scan.step - 1, cause), scan)

    def _follow(self, outcome: Outcome, scan: Scan) -> None:
        """Begin and end the jobs of an outcome."""
        self.outcome, self.changed = outcome, True
        self.founded |= len(self.ensemble.clusters) > 0
        self.event_log.add(outcome.events, outcome.step, scan.stamp_ns)
        self.placement.jobs.end(outcome.end)
        self.placement.jobs.begin(outcome.begin)
        self.placement.resize(outcome.resize)
        self.pose.believed(outcome, scan.odom_from_robot)

    # --- from one coordinator to the next

    def hand_on(self, now_ns: int) -> CheckpointState:
        """Return the state without particles that workers hold; from now on it is unchanged."""
        self.changed = False
        return CheckpointState(
            version=STATE_VERSION,
            map_digest=self.map_digest,
            ensemble=self.ensemble,
            jobs=self.placement.jobs_to_hand_on(),
            collector=self.collector,
            commands=self.commands,
            missing=self.outcome.missing if self.outcome else (),
            age_s=self._applied_age_s(now_ns),
            age_known=self.pose.age_known,
            steps_applied=self.steps_applied,
            reports_missing=self.reports_missing,
            counters=dict(self.counters),
        )

    def _applied_age_s(self, now_ns: int) -> float:
        applied = self.collector.applied
        return min(self.pose.age_of_s(applied.stamp_ns, now_ns), MAX_AGE_S) if applied else -1.0

    def resume(self, checkpoint: Checkpoint, now_ns: int) -> int | None:
        """Continue from another coordinator's state.

        Returns:
            The step that follows; None if the state is of no use, and nothing was changed.
        """
        try:
            state = state_in(checkpoint)
        except ValueError:
            self.count("checkpoint that cannot be read")
            return None
        applied = state.collector.applied
        newest = self.collector.newest_scan
        if not state.ensemble.searches:
            self.commands.resume(state.commands)
            return None
        if self.map_digest not in ("", state.map_digest):
            self.count("checkpoint of another map")
            return None
        if newest and applied and newest.step < applied.step and newest.stamp_ns > applied.stamp_ns:
            self.count("checkpoint of another count of steps")
            return None
        self._restore(state, checkpoint.term, now_ns)
        self.founded = checkpoint.founded or len(self.ensemble.clusters) > 0
        if applied is not None:
            return applied.step + 1
        first = state.ensemble.search.first_step
        self.collector.begin_after(first - 1)
        return first

    def _restore(self, state: CheckpointState, term: int, now_ns: int) -> None:
        self.map_digest = state.map_digest
        settings, self.ensemble = self.ensemble.settings, state.ensemble
        self.ensemble.use(settings)
        rebuilt = partial(self._rebuilt, state)
        self.placement.resume(state.jobs, rebuilt, now_ns, term)
        self._begin_standing_jobs(state.collector.applied)
        self.collector.resume(state.collector)
        self.commands.resume(state.commands)
        self.steps_applied, self.reports_missing = state.steps_applied, state.reports_missing
        for cause, times in state.counters.items():
            self.count(cause, times)
        self.changed = True
        applied = state.collector.applied
        if applied is not None:
            self._use(applied.settings)
            self.pose.resume(
                applied.stamp_ns,
                applied.odom_from_robot,
                state.age_s,
                now_ns,
                live=applied.live,
            )
            self.outcome = self.ensemble.again(applied.step, state.missing)
            self.pose.believed(self.outcome, applied.odom_from_robot)

    def _begin_standing_jobs(self, applied: Scan | None) -> None:
        """Begin the standing jobs that the other coordinator, with other settings, did not have."""
        standing = self.ensemble.standing_jobs(applied.step + 1 if applied else 0)
        jobs = self.placement.jobs
        jobs.begin({job_id: job for job_id, job in standing.items() if jobs.get(job_id) is None})

    def _rebuilt(self, state: CheckpointState, job_id: str) -> TrackJob:
        """Draw a cluster from its Gaussian: its particles were lost with its worker."""
        applied = state.collector.applied
        assert applied is not None  # `state_checks` has looked
        tracked = (*state.ensemble.clusters.all(), *state.ensemble.decoy.places)
        cluster = next(c for c in tracked if c.job_id == job_id)
        scan = mirrored(applied) if cluster.mirrored else applied
        again = self._drawn_anew(
            cluster.cluster, 1.0, cluster.mean, cluster.covariance, scan, applied.step
        )
        return TrackJob(
            cluster=cluster.cluster,
            start=again.sample,
            exact=False,
            particles=cluster.particles,
            particles_from=cluster.particles_from,
            mirrored=cluster.mirrored,
        )

    def _drawn_anew(
        self,
        cluster: int,
        probability: float,
        mean: PoseTuple,
        covariance: Covariance,
        scan: Scan,
        step: int,
    ) -> Place:
        """Return a place after `step`, with particles drawn from its Gaussian."""
        return candidate(
            probability,
            mean,
            covariance,
            seed=self.filter_settings.seed,
            purpose=Purpose.REBUILT,
            entity=cluster,
            step=step,
            odom_from_robot=scan.odom_from_robot,
        )


def _moved(ready: ReadyStep) -> Pose | None:
    """Return the motion since the step that was applied last, or None without one."""
    if ready.before is None:
        return None
    return between(np.array(ready.before.odom_from_robot), np.array(ready.scan.odom_from_robot))
