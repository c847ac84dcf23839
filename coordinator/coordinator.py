"""The coordinator's decisions: told what happened, answers what to send.

No network, no clock: events carry `now_ns`, instructions are plain objects. So a whole failure
story is a unit test.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from coordinator.cluster_set import Candidate
from coordinator.ensemble import Ensemble, Outcome
from coordinator.placement import Placement
from coordinator.pose_tracker import PoseTracker
from coordinator.step_collector import ReadyStep, StepCollector
from particle_filter.random_streams import Purpose, generator
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from protocol.answers import Belief, Hypotheses, PoseAnswer, SetPose, Status
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.steps import OdometryReading, Scan
from protocol.work import OrderAnswer, Particles, Report, TrackReport, WorkOrder

SET_POSE_PARTICLES = 1_000


@dataclass(frozen=True)
class SendOrder:
    """Ask a worker to follow an order."""

    worker: str
    order: WorkOrder


@dataclass(frozen=True)
class PublishBelief:
    """Tell everybody what is believed."""

    belief: Belief
    pose: PoseAnswer


@dataclass(frozen=True)
class FetchScans:
    """Ask the bridge for steps whose scans were lost on their way."""

    first: int
    last: int


Instruction = SendOrder | PublishBelief | FetchScans


class Coordinator:
    """All that the coordinator process knows and decides."""

    def __init__(
        self,
        sender: str,
        filter_settings: FilterSettings,
        settings: CoordinatorSettings,
        version: str,
        now_ns: int,
    ) -> None:
        self._sender, self._settings, self._version = sender, settings, version
        self._filter_settings = filter_settings
        self._started_ns = now_ns
        self._ensemble = Ensemble(filter_settings)
        self._placement = Placement(sender, filter_settings, settings.snapshot_every_steps)
        self._collector = StepCollector(settings)
        self._pose = PoseTracker(sender, settings.stale_after_s)
        self._outcome: Outcome | None = None
        self._begun, self._linked = False, True
        self._applied_scan: Scan | None = None
        self._counters: Counter[str] = Counter()
        self._steps_applied = self._reports_missing = self._set_poses = 0

    # --- events

    def scan(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """A step's scan arrived."""
        if not self._placement.map_digest:
            self._placement.map_digest = scan.map_digest
        elif scan.map_digest != self._placement.map_digest:
            self._counters["scan of another map"] += 1
            return []
        if not self._collector.take_scan(scan, now_ns):
            self._counters["scan repeated or late"] += 1
            return []
        if not self._begun:
            self._placement.begin(self._ensemble.begin_at(scan.step))
            self._begun = True
        self._pose.scan(scan.stamp_ns, scan.odom_from_robot, now_ns)
        lost = self._collector.lost_before(scan)
        return ([FetchScans(*lost)] if lost else []) + self.tick(now_ns)

    def odometry(self, reading: OdometryReading, now_ns: int) -> None:
        """The robot moved."""
        self._pose.odometry(reading.stamp_ns, reading.odom_from_robot, now_ns)

    def report(self, report: Report, worker: str, now_ns: int) -> list[Instruction]:
        """A worker's job took a step; of a job that another worker has, it has nothing to say."""
        if self._placement.is_of_another(report.job_id, report.epoch, worker):
            self._counters["report of another worker's job"] += 1
            return []
        if not self._placement.is_current(report.job_id, report.epoch):
            self._counters["report of an old epoch"] += 1
            return []
        snapshot = report.snapshot if isinstance(report, TrackReport) else None
        self._placement.reported(report.job_id, snapshot)
        if not self._collector.take_report(report):
            self._counters["report late"] += 1
        return self.tick(now_ns)

    def worker_joined(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token appeared."""
        self._placement.joined(name)
        return self.tick(now_ns)

    def worker_left(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token is gone."""
        self._placement.left(name)
        return self.tick(now_ns)

    def worker_returned(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker that was away with our link is back; whether it is the same, it will say."""
        self._placement.returned(name)
        return self.tick(now_ns)

    def link_lost(self) -> None:
        """Our own link is down: nothing is decided until it is back."""
        self._linked = False

    def link_back(self, now_ns: int) -> list[Instruction]:
        """Our own link is back: steps under way get their whole deadline again."""
        self._linked = True
        self._collector.wait_anew(now_ns)
        return self.tick(now_ns)

    def order_answered(self, worker: str, answer: OrderAnswer) -> None:
        """A worker took an order, or says why not."""
        if answer.problem:
            self._counters[f"order refused: {answer.problem}"] += 1
        self._placement.answered(worker, answer)

    def set_pose(self, command: SetPose, now_ns: int) -> list[Instruction]:
        """A person says where the robot is.

        Raises:
            ValueError: no scan has been seen yet, so there is nothing to start from.
        """
        scan = self._start_scan()
        outcome = self._ensemble.set_pose(self._given(command, scan))
        return self._follow(outcome, scan, now_ns) + self.tick(now_ns)

    def relocalize(self, now_ns: int) -> list[Instruction]:
        """Forget everything and search.

        Raises:
            ValueError: no scan has been seen yet, so the search runs anyway.
        """
        scan = self._start_scan()
        return self._follow(self._ensemble.relocalize(scan.step), scan, now_ns) + self.tick(now_ns)

    def tick(self, now_ns: int) -> list[Instruction]:
        """Apply the steps that are due and tell workers what is news to them."""
        instructions: list[Instruction] = []
        if not self._linked:
            return instructions
        while ready := self._collector.ready(
            self._ensemble.expected, self._placement.placed_ns, now_ns
        ):
            instructions += self._apply(ready, now_ns)
        orders = self._placement.orders(now_ns)
        return [SendOrder(worker, order) for worker, order in orders] + instructions

    # --- answers

    def pose(self, now_ns: int) -> PoseAnswer:
        """Where the robot is now."""
        return self._pose.answer(now_ns, len(self._placement.workers))

    def hypotheses(self, now_ns: int) -> Hypotheses:
        """All places with their probabilities."""
        return Hypotheses(
            sender=self._sender, pose=self.pose(now_ns), hypotheses=self._pose.hypotheses()
        )

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """How the system is; `counters` are those of the process around."""
        pose = self.pose(now_ns)
        return Status(
            sender=self._sender,
            version=self._version,
            state=pose.state,
            freshness=pose.freshness,
            age_s=pose.age_s,
            step=pose.step,
            steps_applied=self._steps_applied,
            steps_lost=self._collector.steps_lost,
            reports_missing=self._reports_missing,
            map_digest=self._placement.map_digest,
            clusters=len(self._ensemble.clusters),
            searching=self._outcome.searching if self._outcome else False,
            workers=self._placement.workers,
            counters=dict(sorted((self._counters + Counter(counters)).items())),
            uptime_s=(now_ns - self._started_ns) / 1e9,
        )

    # --- within

    def _apply(self, ready: ReadyStep, now_ns: int) -> list[Instruction]:
        outcome = self._ensemble.advance(ready.scan.step, ready.reports)
        self._applied_scan = ready.scan
        self._steps_applied += 1
        self._reports_missing += len(outcome.missing)
        return self._follow(outcome, ready.scan, now_ns)

    def _follow(self, outcome: Outcome, scan: Scan, now_ns: int) -> list[Instruction]:
        """Hand out the jobs of an outcome and publish its belief."""
        self._outcome = outcome
        self._placement.end(outcome.end)
        self._placement.begin(outcome.begin)
        self._pose.believed(outcome, scan.odom_from_robot)
        return [PublishBelief(self._belief(outcome, scan), self.pose(now_ns))]

    def _belief(self, outcome: Outcome, scan: Scan) -> Belief:
        return Belief(
            sender=self._sender,
            step=outcome.step,
            stamp_ns=scan.stamp_ns,
            odom_from_robot=scan.odom_from_robot,
            state=outcome.state,
            hypotheses=outcome.hypotheses,
            searching=outcome.searching,
            missing=outcome.missing,
            last=scan.last,
        )

    def _start_scan(self) -> Scan:
        """The scan at whose time a command takes effect: the last applied one."""
        if self._applied_scan is None:
            raise ValueError("no scan has arrived yet; start the robot or the recording first")
        return self._applied_scan

    def _given(self, command: SetPose, scan: Scan) -> Candidate:
        """A Gaussian cloud round the pose that a person gives."""
        self._set_poses += 1
        rng = generator(
            self._filter_settings.seed,
            purpose=Purpose.GIVEN_POSE,
            entity=self._set_poses,
            step=scan.step,
        )
        sigma = np.array(
            [command.position_sigma_m, command.position_sigma_m, command.heading_sigma_rad]
        )
        spread = rng.standard_normal((SET_POSE_PARTICLES, 3)) * sigma
        mean: PoseTuple = command.map_from_robot
        place, turn = command.position_sigma_m**2, command.heading_sigma_rad**2
        return Candidate(
            probability=self._filter_settings.belief.set_pose_probability,
            mean=mean,
            covariance=(place, 0.0, 0.0, 0.0, place, 0.0, 0.0, 0.0, turn),
            sample=Particles(
                step=scan.step,
                odom_from_robot=scan.odom_from_robot,
                map_from_robot=ArrayBlob.of(np.array(mean) + spread, "float64"),
                log_weights=ArrayBlob.of(np.zeros(SET_POSE_PARTICLES), "float64"),
            ),
        )
