"""All that a coordinator holds: what it believes, who does what, and what it still waits for.

Everything here that decides can be handed on to another coordinator, and be taken over from one.
"""

from collections import Counter

import msgspec
import numpy as np

from coordinator.belief.ensemble import Ensemble
from coordinator.belief.given_places import candidate
from coordinator.belief.outcome import Outcome
from coordinator.checkpoint import STATE_VERSION, CheckpointState, PriorPose, from_bytes
from coordinator.event_log import EventLog
from coordinator.membership.placement import Placement
from coordinator.pose.pose_tracker import PoseTracker
from coordinator.step_collector import ReadyStep, StepCollector
from particle_filter.arrays import Pose
from particle_filter.poses import between
from particle_filter.random_streams import Purpose
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.steps import Scan
from protocol.work import Checkpoint, Report, TrackJob, TrackReport

HANDED_ON_COMMANDS = 20


class CoordinatorState:
    """The parts of a coordinator's knowledge, and what moves between them."""

    def __init__(
        self,
        sender: str,
        filter_settings: FilterSettings,
        settings: CoordinatorSettings,
    ) -> None:
        self._seed = filter_settings.seed
        self.ensemble = Ensemble(filter_settings)
        self.placement = Placement(sender, filter_settings, settings.snapshot_every_steps)
        self.collector = StepCollector(settings)
        self.pose = PoseTracker(sender, settings.stale_after_s)
        self.event_log = EventLog()
        self.outcome: Outcome | None = None
        self.applied_scan: Scan | None = None
        self.counters: Counter[str] = Counter()
        self.commands_done: dict[str, str] = {}
        """The last commands' ids to the reason why they were refused."""
        self.steps_applied = self.reports_missing = self.set_poses = 0
        self.changed = False
        """Whether others have to be told before anything that is decided leaves this process."""

    def on_report(self, report: Report, worker: str) -> None:
        """A worker's job took a step; of a job that another worker has, it has nothing to say."""
        if self.placement.is_of_another(report.job_id, report.epoch, worker):
            self.counters["report of another worker's job"] += 1
            return
        if not self.placement.is_current(report.job_id, report.epoch):
            self.counters["report of an old epoch"] += 1
            return
        snapshot = report.snapshot if isinstance(report, TrackReport) else None
        in_time = self.collector.take_report(report)
        self.placement.reported(report.job_id, snapshot, in_time=in_time)
        if not in_time:
            self.counters["report late"] += 1

    def apply(self, ready: ReadyStep, now_ns: int) -> None:
        """Decide a step."""
        expected = self.ensemble.expected
        outcome = self.ensemble.advance(
            ready.scan.step, ready.reports, self._moved_to(ready.scan.odom_from_robot)
        )
        self.placement.step_decided(expected, outcome.missing, now_ns)
        self.applied_scan = ready.scan
        self.steps_applied += 1
        self.reports_missing += len(outcome.missing)
        self.follow(outcome, ready.scan)

    def _moved_to(self, odom_from_robot: PoseTuple) -> Pose | None:
        """How the robot moved since the step that was applied last."""
        if self.applied_scan is None:
            return None
        return between(np.array(self.applied_scan.odom_from_robot), np.array(odom_from_robot))

    def follow(self, outcome: Outcome, scan: Scan) -> None:
        """Hand out the jobs of an outcome."""
        self.outcome, self.changed = outcome, True
        self.event_log.add(outcome.events, outcome.step, scan.stamp_ns)
        self.placement.end(outcome.end)
        self.placement.begin(outcome.begin)
        self.pose.believed(outcome, scan.odom_from_robot)

    def begin_search(self, first_step: int, prior_pose: PriorPose | None) -> None:
        """Search for the first time."""
        self.collector.begin_after(first_step - 1)
        self.placement.begin(self.ensemble.begin_at(first_step, prior_pose))
        self.changed = True

    def count_anew(self, scan: Scan) -> None:
        """The bridge has forgotten the steps so far, and with them where odometry was."""
        self.counters["steps counted anew"] += 1
        self.collector.restart(scan.step - 1)
        self.follow(self.ensemble.relocalize(scan.step - 1, "steps restarted"), scan)
        self.applied_scan = None

    # --- handed on

    def state(self, now_ns: int) -> CheckpointState:
        """All that decides, but for particles that workers hold."""
        return CheckpointState(
            version=STATE_VERSION,
            map_digest=self.placement.map_digest,
            ensemble=self.ensemble.state(),
            jobs=self.placement.state(),
            applied=_without_beams(self.applied_scan),
            missing=self.outcome.missing if self.outcome else (),
            age_s=self.pose.age_s(now_ns),
            steps_applied=self.steps_applied,
            steps_lost=self.collector.steps_lost,
            reports_missing=self.reports_missing,
            set_poses=self.set_poses,
            counters=dict(self.counters),
            commands_done=dict(list(self.commands_done.items())[-HANDED_ON_COMMANDS:]),
        )

    def resume(self, checkpoint: Checkpoint, now_ns: int) -> int | None:
        """Take over another's state; returns the step that follows, None if they are of no use."""
        try:
            state = from_bytes(checkpoint.state)
        except ValueError:
            self.counters["checkpoint that cannot be read"] += 1
            return None
        search, applied, newest = state.ensemble.search, state.applied, self.collector.newest_scan
        if not state.ensemble.searches:
            return None
        if self.placement.map_digest not in ("", state.map_digest):
            self.counters["checkpoint of another map"] += 1
            return None
        if newest and applied and newest.step < applied.step:
            self.counters["checkpoint of another count of steps"] += 1
            return None
        self._restore(state, now_ns)
        if applied is not None:
            return applied.step + 1
        return search.first_step if search else 0

    def _restore(self, state: CheckpointState, now_ns: int) -> None:
        self.ensemble.restore(state.ensemble)
        self.placement.map_digest = state.map_digest
        self.placement.restore(state.jobs, lambda job_id: self._rebuilt(job_id, state), now_ns)
        self.applied_scan = applied = state.applied
        self.collector.resume(applied.step if applied else None, state.steps_lost)
        self.steps_applied, self.set_poses = state.steps_applied, state.set_poses
        self.reports_missing = state.reports_missing
        self.counters.update(state.counters)
        self.commands_done |= state.commands_done
        self.changed = True
        if applied is not None:
            self.pose.resume(
                applied.stamp_ns,
                applied.odom_from_robot,
                state.age_s,
                now_ns,
                live=applied.live,
            )
            self.outcome = self.ensemble.again(applied.step, state.missing)
            self.pose.believed(self.outcome, applied.odom_from_robot)

    def _rebuilt(self, job_id: str, state: CheckpointState) -> TrackJob:
        """A cluster whose particles were lost with its worker: drawn anew from its Gaussian."""
        assert state.applied is not None  # `from_bytes` has looked
        cluster = next(c for c in state.ensemble.clusters if c.job_id == job_id)
        again = candidate(
            1.0,
            cluster.mean,
            cluster.covariance,
            seed=self._seed,
            purpose=Purpose.REBUILT,
            entity=cluster.cluster,
            step=state.applied.step,
            odom_from_robot=state.applied.odom_from_robot,
        )
        return TrackJob(cluster=cluster.cluster, start=again.sample, exact=False)


def _without_beams(scan: Scan | None) -> Scan | None:
    empty = ArrayBlob(dtype="float32", shape=(0,), data=b"")
    return scan and msgspec.structs.replace(scan, ranges=empty)
