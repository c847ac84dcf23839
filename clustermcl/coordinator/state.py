"""The state of a coordinator: the belief, the jobs, the open steps, and the commands.

A coordinator transfers what its successor needs as a `CheckpointState`.
"""

from functools import partial

import numpy as np
from msgspec import field
from msgspec.structs import replace

from clustermcl.belief.cluster_set import Cluster
from clustermcl.belief.commands import Commands, command_remark
from clustermcl.belief.dead_reckoning import DeadReckoning, carried
from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.free_ground import FreeGround
from clustermcl.belief.given_places import candidate
from clustermcl.belief.outcome import Outcome
from clustermcl.belief.part import Part
from clustermcl.belief.pose_tracker import PoseTracker
from clustermcl.coordinator.change_detectors import MapChangeDetector, OverloadDetector
from clustermcl.coordinator.checkpoint import MAX_AGE_S, STATE_VERSION, CheckpointState, state_in
from clustermcl.coordinator.event_log import EventLog
from clustermcl.coordinator.placement import Placement
from clustermcl.coordinator.step_collector import ReadyStep, StepCollector
from clustermcl.filter.poses import between
from clustermcl.filter.random_streams import Purpose
from clustermcl.filter.settings import FilterSettings, filter_with, section_with
from clustermcl.protocol.answers import Relocalize, SetPose
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.job_events import EndedCause
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.steps import Scan, mirrored
from clustermcl.protocol.work import Checkpoint, Place, Report, TrackJob
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings

ASK_MAP_AGAIN_NS = 2_000_000_000


class CoordinatorState(Part):
    """The belief, the jobs, the open steps and the commands of one robot."""

    filter_settings: FilterSettings
    settings: CoordinatorSettings
    bridge: BridgeSettings
    ensemble: Ensemble
    placement: Placement
    collector: StepCollector
    pose: PoseTracker
    live: LiveSettings = AS_STARTED
    """Settings changed since the start, as of the applied step."""
    event_log: EventLog = field(default_factory=EventLog)
    commands: Commands = field(default_factory=Commands)
    counters: dict[str, int] = {}
    steps_applied: int = 0
    reports_missing: int = 0
    """Reports that a step has lacked; not those of searches, which a later step uses."""
    overload: OverloadDetector = field(default_factory=OverloadDetector)
    map_digest: str = ""
    """Digest of the map in which the robot is localized; empty before the first scan."""
    map_changes: MapChangeDetector = field(default_factory=MapChangeDetector)
    ground: FreeGround | None = None
    """Free ground of the last map that has arrived."""
    map_asked_ns: int | None = None
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
        return cls(
            filter_settings,
            settings,
            bridge,
            Ensemble.of(filter_settings),
            Placement(sender, filter_settings, settings.snapshot_every_steps),
            StepCollector(settings),
            PoseTracker(sender, settings, DeadReckoning(filter_settings.motion, bridge)),
        )

    def count(self, cause: Cause) -> None:
        self.counters[cause] = self.counters.get(cause, 0) + 1

    @property
    def applied_step(self) -> int:
        """The last applied step; -1: there is none."""
        return self.collector.applied.step if self.collector.applied else -1

    @property
    def newest_step(self) -> int:
        """The newest step whose scan has arrived, applied or not; -1: there is none."""
        newest = self.collector.newest_scan
        return max(newest.step, self.applied_step) if newest else self.applied_step

    def _use(self, live: LiveSettings) -> None:
        if live != self.live:
            self.live = live
            settings = filter_with(self.filter_settings, live)
            self.ensemble.use(settings)
            odometry = self.pose.since_step
            odometry.motion, odometry.bridge = settings.motion, section_with(self.bridge, live)

    # --- what happens

    def on_map(self, scan: Scan) -> bool:
        """Return whether a scan belongs to the present map; follow the bridge to a new map."""
        if not self.map_digest:
            self.map_digest, self.map_asked_ns = scan.map_digest, None
        if self.map_changes.has_changed(scan, self.map_digest):
            self._change_map(scan)
        if scan.map_digest != self.map_digest:
            self.count(Cause.OTHER_MAP)
        return scan.map_digest == self.map_digest

    @property
    def _free_ground(self) -> FreeGround | None:
        known = self.ground
        return known if known and self.map_digest in ("", known.map_digest) else None

    def wants_map(self, now_ns: int) -> bool:
        """Return whether to request the map now, against which given poses are checked."""
        asked_ns = self.map_asked_ns
        is_asked = asked_ns is not None and now_ns - asked_ns < ASK_MAP_AGAIN_NS
        if is_asked or self._free_ground is not None:
            return False
        self.map_asked_ns = now_ns
        return True

    def on_map_arrived(self, ground: FreeGround) -> bool:
        """Store the map's free ground; return whether a given pose that waited was applied."""
        self.ground = ground
        applied = self.collector.applied
        return applied is not None and self._carry_out_waiting(applied)

    def on_report(self, report: Report, worker: str, now_ns: int) -> None:
        if refusal := self.placement.jobs.refusal_of(report, worker):
            self.count(refusal)
            return
        if not self.collector.has_room_for(report):
            self.count(Cause.NO_ROOM)
            return
        in_time = self.collector.on_report(report, now_ns)
        self.placement.on_report(report, in_time=in_time)

    @property
    def awaits_reports(self) -> bool:
        """Whether no step can be applied now: no step is open, or a report is missing."""
        scan = self.collector.oldest_scan
        if scan is None:
            return True
        reports = self.collector.open_steps[scan.step].reports
        waits_for_searches = scan.lockstep or self.settings.search_deadline_s > 0.0
        deferrable = () if waits_for_searches else self.ensemble.deferrable
        return any(
            job_id not in reports and job_id not in deferrable and self.placement.waits_for(job_id)
            for job_id in self.ensemble.expected
        )

    def ready(self, now_ns: int) -> ReadyStep | None:
        """Return the next step if it is due, else None; the caller must apply a returned step."""
        if self.collector.oldest_scan is None:
            return None
        expected = list(filter(self.placement.waits_for, self.ensemble.expected))
        placed_ns, deferrable = self.placement.jobs.placed_ns, self.ensemble.deferrable
        return self.collector.ready(expected, placed_ns, now_ns, deferrable)

    def apply(self, ready: ReadyStep, now_ns: int) -> None:
        scan, before = ready.scan, ready.before
        self._use(scan.settings)
        # Steps of a search, and of a recording that waits for each belief, may take longer.
        if not (scan.lockstep or self.pose.outcome.searching):
            self.overload.on_step_decided(now_ns - ready.arrived_ns)
            if self.overload.is_overloaded:
                self.ensemble.search.postpone(scan.step)
        self.event_log.add(scan.remarks, scan.step, scan.stamp_ns)
        expected = self.ensemble.expected
        weighing = self.ensemble.clusters.job_ids or expected
        after = np.array(scan.odom_from_robot)
        moved = None if before is None else between(np.array(before.odom_from_robot), after)
        outcome = self.ensemble.advance(scan.step, ready.reports, moved, scan)
        patient = self.overload.is_overloaded
        self.placement.on_step_decided(expected, outcome.missing, now_ns, patient=patient)
        self.placement.jobs.step_applied(scan.step)
        self.steps_applied += 1
        self.reports_missing += len(set(outcome.missing) - set(self.ensemble.search_ids))
        if not outcome.missing or set(weighing) - set(outcome.missing):
            self.pose.weighed(scan)
        self._follow(outcome, scan)
        self._carry_out_waiting(scan)

    def _carry_out_waiting(self, applied: Scan) -> bool:
        history, ground = self.pose.history, self._free_ground
        given = self.commands.carry_out_waiting(self.ensemble, applied, history, ground)
        if isinstance(given, str):
            self.count(Cause.POSE_OFF_MAP)
            return False
        return self._follow_command(given, applied)

    def _follow_command(self, outcome: Outcome | None, applied: Scan | None) -> bool:
        """Carry out what follows from a command; return False if it has no outcome yet."""
        if outcome is None or applied is None:
            return False
        self.founded = True
        self._follow(outcome, applied)
        return True

    def carry_out(self, command: SetPose | Relocalize) -> bool:
        """Carry out a command; return False if it waits for the first step or is refused."""
        self.changed = True
        applied, history, ground = self.collector.applied, self.pose.history, self._free_ground
        outcome = self.commands.carry_out(command, self.ensemble, applied, history, ground)
        remark = command_remark(command, self.commands.problems[command.command_id])
        stamp_ns = applied.stamp_ns if applied else history.newest_ns or 0
        self.event_log.add([remark], self.applied_step, stamp_ns)
        return self._follow_command(outcome, applied)

    def _change_map(self, scan: Scan) -> None:
        """Use the bridge's new map: keep the places if so configured, or search again."""
        self.count(Cause.MAP_CHANGED)
        self.map_digest = scan.map_digest
        applied = self.collector.applied
        keeps = self.settings.keep_pose_on_new_map and applied and len(self.ensemble.clusters)
        if not keeps or applied is None or applied.floors.names != scan.floors.names:
            self.search_again(scan, "new map")
            return
        places = [self._in_new_map(c, applied, scan) for c in self.ensemble.clusters.all()]
        self.collector.restart(scan.step - 1, replace(scan, step=scan.step - 1))
        self._follow(self.ensemble.continue_from(places, scan.step - 1, "new map"), scan)

    def _in_new_map(self, cluster: Cluster, applied: Scan, scan: Scan) -> Place:
        """Return a cluster's place just before the first scan of another map."""
        odometry = applied.odom_from_robot, scan.odom_from_robot
        motion = self.ensemble.settings.motion
        mean, covariance = carried(cluster.pose, cluster.covariance, *odometry, motion)
        mean = scan.floors.in_atlas(*applied.floors.on_floor(mean))
        moved = replace(cluster, pose=mean, covariance=covariance)
        return self._redrawn(moved, cluster.probability, scan, scan.step - 1)

    def search_again(self, scan: Scan, cause: EndedCause) -> None:
        """Forget all places and search from this scan on, unless the first search is still due."""
        self.collector.restart(scan.step - 1)
        if self.ensemble.searches:
            self._follow(self.ensemble.relocalize(scan.step - 1, cause), scan)

    def _follow(self, outcome: Outcome, scan: Scan) -> None:
        self.changed = True
        self.founded |= len(self.ensemble.clusters) > 0
        self.event_log.add(outcome.events, outcome.step, scan.stamp_ns)
        self.placement.jobs.end(outcome.end)
        self.placement.jobs.begin(outcome.begin)
        self.placement.resize(outcome.resize)
        self.pose.believed(outcome, scan.odom_from_robot)

    # --- from one coordinator to the next

    def hand_on(self, now_ns: int) -> CheckpointState:
        """Return the state for a successor, without particles that workers hold."""
        self.changed = False
        applied, pose = self.collector.applied, self.pose
        age_s = min(pose.age_of_s(applied.stamp_ns, now_ns), MAX_AGE_S) if applied else -1.0
        return CheckpointState(
            version=STATE_VERSION,
            map_digest=self.map_digest,
            ensemble=self.ensemble,
            jobs=self.placement.jobs_to_hand_on(),
            collector=self.collector,
            commands=self.commands,
            event_log=self.event_log.recent(),
            missing=pose.outcome.missing,
            age_s=age_s,
            steps_applied=self.steps_applied,
            reports_missing=self.reports_missing,
            counters=dict(self.counters),
        )

    def resume(self, checkpoint: Checkpoint, now_ns: int) -> int | None:
        """Continue from another coordinator's state; return the next step; None: unusable."""
        try:
            state = state_in(checkpoint)
        except ValueError:
            self.count(Cause.OLD_FORMAT)
            return None
        applied = state.collector.applied
        newest = self.collector.newest_scan
        if not state.ensemble.searches:
            self.commands.resume(state.commands)
            return None
        if self.map_digest not in ("", state.map_digest):
            self.count(Cause.OLD_MAP)
            return None
        if newest and applied and newest.step < applied.step and newest.stamp_ns > applied.stamp_ns:
            self.count(Cause.OLD_STEPS)
            return None
        self._restore(state, checkpoint.term, now_ns)
        self.founded = checkpoint.founded or len(self.ensemble.clusters) > 0
        if applied is not None:
            return applied.step + 1
        first = state.ensemble.search.pool.first_step
        self.collector.begin_after(first - 1)
        return first

    def _restore(self, state: CheckpointState, term: int, now_ns: int) -> None:
        self.map_digest = state.map_digest
        settings, self.ensemble = self.ensemble.settings, state.ensemble
        self.ensemble.use(settings)
        self.placement.resume(state.jobs, partial(self._rebuilt, state), now_ns, term)
        applied, jobs = state.collector.applied, self.placement.jobs
        # The other coordinator, with other settings, may not have had all standing jobs.
        standing = self.ensemble.standing_jobs(applied.step + 1 if applied else 0)
        jobs.begin({job_id: job for job_id, job in standing.items() if job_id not in jobs.placed})
        self.collector.resume(state.collector)
        self.commands.resume(state.commands)
        self.event_log = state.event_log
        self.steps_applied, self.reports_missing = state.steps_applied, state.reports_missing
        for cause, times in state.counters.items():
            self.counters[cause] = self.counters.get(cause, 0) + times
        self.changed = True
        if applied is not None:
            self._use(applied.settings)
            self.pose.resume(applied, state.age_s, now_ns)
            outcome = self.ensemble.outcome(applied.step, state.missing)
            self.pose.believed(outcome, applied.odom_from_robot)

    def _rebuilt(self, state: CheckpointState, job_id: str) -> TrackJob:
        """Draw a cluster from its Gaussian: its particles were lost with its worker."""
        applied = state.collector.applied
        assert applied is not None  # no cluster is tracked before the first step
        tracked = (*state.ensemble.clusters.all(), *state.ensemble.decoy.places)
        cluster = next(c for c in tracked if c.job_id == job_id)
        scan = mirrored(applied) if cluster.mirrored else applied
        return TrackJob(
            cluster=cluster.cluster,
            start=self._redrawn(cluster, 1.0, scan, applied.step).sample,
            exact=False,
            particles=cluster.particles,
            particles_from=cluster.particles_from,
            mirrored=cluster.mirrored,
        )

    def _redrawn(self, cluster: Cluster, probability: float, scan: Scan, step: int) -> Place:
        """Return a cluster's place after `step`, with particles drawn from its Gaussian."""
        return candidate(
            probability,
            cluster.pose,
            cluster.covariance,
            seed=self.filter_settings.seed,
            purpose=Purpose.REBUILT,
            entity=cluster.cluster,
            step=step,
            odom_from_robot=scan.odom_from_robot,
        )
