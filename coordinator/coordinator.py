"""The coordinator's decisions: told what happened, answers what to send.

No network, no clock: events carry `now_ns`, instructions are plain objects. So a whole failure
story is a unit test.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from types import MappingProxyType

import msgspec

from coordinator.checkpoint import STATE_VERSION, CoordinatorState, OfferState, from_bytes
from coordinator.cluster_set import Candidate
from coordinator.ensemble import Ensemble, Outcome
from coordinator.given_places import candidate, diagonal
from coordinator.inquiry import Told
from coordinator.instructions import FetchScans, Instruction, PublishBelief, SendOrder
from coordinator.last_pose import LastPose
from coordinator.placement import Placement
from coordinator.pose_tracker import PoseTracker
from coordinator.step_collector import ReadyStep, StepCollector
from coordinator.succession import Succession
from particle_filter.random_streams import Purpose
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from protocol.answers import (
    Belief,
    CommandDone,
    Hypotheses,
    PoseAnswer,
    Relocalize,
    SetPose,
    Status,
)
from protocol.arrays import ArrayBlob
from protocol.numbering import Numbering
from protocol.steps import OdometryReading, Scan
from protocol.work import Checkpoint, OrderAnswer, Report, TrackJob, TrackReport

KEPT_COMMANDS = 100
"""A command that is asked once more is answered as before, if it is one of the last."""
HANDED_ON_COMMANDS = 20
NEVER_LATER = 16
"""More steps than this lost before the first scan that is heard, and nobody looks for them."""


class Coordinator:
    """All that the coordinator process knows and decides."""

    def __init__(
        self,
        sender: str,
        filter_settings: FilterSettings,
        settings: CoordinatorSettings,
        version: str,
        now_ns: int,
        *,
        term: int = 0,
        known: Checkpoint | None = None,
        last_poses: Mapping[str, LastPose] = MappingProxyType({}),
    ) -> None:
        """Know nothing yet.

        Args:
            sender: name of the process.
            filter_settings: the filter's numbers.
            settings: the coordinator's.
            version: of the software.
            now_ns: by the clock of all events.
            term: see `Succession`; raised above all that workers know.
            known: a checkpoint that was heard before the workers are asked.
            last_poses: where the robot was at the end of an earlier life, by the map's digest.
        """
        self._sender, self._settings, self._version = sender, settings, version
        self._filter_settings = filter_settings
        self._started_ns = now_ns
        self._ensemble = Ensemble(filter_settings)
        self._placement = Placement(sender, filter_settings, settings.snapshot_every_steps)
        self._collector = StepCollector(settings)
        self._pose = PoseTracker(sender, settings.stale_after_s)
        self._outcome: Outcome | None = None
        self._linked, self._last_poses = True, last_poses
        self._succession = Succession(sender, term, known, now_ns)
        self._numbering = Numbering()
        self._early_reports: list[tuple[Report, str]] = []
        self._commands_done: dict[str, str] = {}
        self._applied_scan: Scan | None = None
        self._counters: Counter[str] = Counter()
        self._steps_applied = self._reports_missing = self._set_poses = 0
        self._changed = False
        """Whether others have to be told before anything that is decided leaves this process."""

    @property
    def outranked_by(self) -> int | None:
        """A higher term that somebody knows of: another coordinator acts, this one must not."""
        return self._succession.outranked_by

    @property
    def map_digest(self) -> str:
        """Of the map in which the robot is looked for; empty before the first scan."""
        return self._placement.map_digest

    @property
    def begun(self) -> bool:
        """Whether it knows enough to answer."""
        return self._succession.begun

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
            if self.begun and self._numbering.starts_anew(scan, self._applied_scan):
                return self._start_anew(scan, now_ns)
            return self._said_again(scan, now_ns)
        self._pose.scan(scan.stamp_ns, scan.odom_from_robot, now_ns)
        if not self.begun:
            return self.tick(now_ns)
        self._begin_search(scan)
        lost = self._collector.lost_before(scan)
        return ([FetchScans(*lost)] if lost else []) + self.tick(now_ns)

    def history(self, scans: Sequence[Scan], now_ns: int) -> list[Instruction]:
        """Steps of the past; a coordinator without any begins with the newest of them."""
        if self.begun and not self._ensemble.searches:
            newest = scans[-1].step if scans else -1
            self._collector.begin_after(newest - 1 if scans else -1)
            scans = scans[-1:]
        return [do for scan in scans for do in self.scan(scan, now_ns)]

    def odometry(self, reading: OdometryReading, now_ns: int) -> None:
        """The robot moved."""
        self._pose.odometry(reading.stamp_ns, reading.odom_from_robot, now_ns)

    def report(self, report: Report, worker: str, now_ns: int) -> list[Instruction]:
        """A worker's job took a step; of a job that another worker has, it has nothing to say."""
        if not self.begun:
            self._early_reports.append((report, worker))
            return self.tick(now_ns)
        self._take(report, worker)
        return self.tick(now_ns)

    def _take(self, report: Report, worker: str) -> None:
        if self._placement.is_of_another(report.job_id, report.epoch, worker):
            self._counters["report of another worker's job"] += 1
            return
        if not self._placement.is_current(report.job_id, report.epoch):
            self._counters["report of an old epoch"] += 1
            return
        snapshot = report.snapshot if isinstance(report, TrackReport) else None
        in_time = self._collector.take_report(report)
        self._placement.reported(report.job_id, snapshot, in_time=in_time)
        if not in_time:
            self._counters["report late"] += 1

    def worker_joined(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token appeared."""
        missed = self._placement.misses(name)
        self._placement.joined(name, self._succession.joined(name, now_ns, missed=missed))
        self._changed = True  # a newcomer has heard no checkpoint yet
        return self.tick(now_ns)

    def worker_told(self, name: str, told: Told, now_ns: int) -> list[Instruction]:
        """A worker says what it does, and what the last coordinator had decided."""
        if not self._placement.has(name):
            return []
        self._succession.answered(name, told)
        if not self.begun:
            return self.tick(now_ns)
        newest = told.checkpoint
        if newest and newest.founded and not self._succession.founded:
            return self._resume(newest, now_ns) + self.tick(now_ns)
        return self._hear_out(name, told, now_ns) + self.tick(now_ns)

    def checkpoint_heard(self, checkpoint: Checkpoint) -> None:
        """Some coordinator, perhaps this one, published its checkpoint."""
        self._succession.hear(checkpoint)

    def worker_left(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token is gone."""
        self._placement.left(name)
        self._succession.left(name)
        self._changed = True
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
            self._counters["order refused"] += 1  # the worker's log says why
        self._succession.hear_term(answer.term)
        self._placement.answered(worker, answer)

    def command(
        self, command: SetPose | Relocalize, now_ns: int
    ) -> tuple[CommandDone, list[Instruction]]:
        """A person says where the robot is, or to search everywhere; done once for each id."""
        known, instructions = command.command_id in self._commands_done, []
        if not known:
            problem = ""
            try:
                instructions = self._carried_out(command, now_ns)
            except ValueError as error:
                problem = str(error)
            self._commands_done[command.command_id] = problem
            while len(self._commands_done) > KEPT_COMMANDS:
                del self._commands_done[next(iter(self._commands_done))]
            instructions += self.tick(now_ns)
        problem = self._commands_done[command.command_id]
        return CommandDone(sender=self._sender, problem=problem), instructions

    def _carried_out(self, command: SetPose | Relocalize, now_ns: int) -> list[Instruction]:
        scan = self._start_scan()
        if isinstance(command, SetPose):
            outcome = self._ensemble.set_pose(self._given(command, scan))
        else:
            outcome = self._ensemble.relocalize(scan.step)
        self._succession.founded = True
        return self._follow(outcome, scan, now_ns)

    def tick(self, now_ns: int) -> list[Instruction]:
        """Apply the steps that are due and tell workers what is news to them."""
        if not self._linked or self.outranked_by is not None:
            return []
        instructions: list[Instruction] = list(self._succession.questions(now_ns))
        if not self.begun:
            if not self._succession.may_begin(now_ns):
                return instructions
            instructions += self._begin(now_ns)
        while ready := self._collector.ready(
            self._placement.waited_for(self._ensemble.expected), self._placement.placed_ns, now_ns
        ):
            instructions += self._apply(ready, now_ns)
        orders = self._placement.orders(now_ns)
        if self._changed or orders:
            first: list[Instruction] = [self._succession.hand_on(self._state(now_ns), now_ns)]
            self._changed = False
        else:
            first = list(self._succession.sign_of_life(now_ns))
        return [*first, *(SendOrder(worker, order) for worker, order in orders), *instructions]

    # --- answers

    def pose(self, now_ns: int) -> PoseAnswer:
        """Where the robot is now."""
        answer = self._pose.answer(now_ns, len(self._placement.workers))
        return msgspec.structs.replace(answer, term=self._succession.term)

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
            term=self._succession.term,
        )

    # --- within

    def _apply(self, ready: ReadyStep, now_ns: int) -> list[Instruction]:
        expected = self._ensemble.expected
        outcome = self._ensemble.advance(ready.scan.step, ready.reports)
        self._placement.step_decided(expected, outcome.missing, now_ns)
        self._applied_scan = ready.scan
        self._steps_applied += 1
        self._reports_missing += len(outcome.missing)
        return self._follow(outcome, ready.scan, now_ns)

    def _follow(self, outcome: Outcome, scan: Scan, now_ns: int) -> list[Instruction]:
        """Hand out the jobs of an outcome and publish its belief."""
        self._outcome, self._changed = outcome, True
        self._succession.founded |= len(self._ensemble.clusters) > 0
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
            term=self._succession.term,
        )

    def _start_anew(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """The bridge has forgotten the steps so far, and with them where odometry was."""
        self._counters["steps counted anew"] += 1
        self._collector.restart(scan.step - 1)
        outcome = self._ensemble.relocalize(scan.step - 1)
        self._follow(outcome, scan, now_ns)
        self._applied_scan = None
        return self.scan(scan, now_ns)

    def _said_again(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """A step that comes again waits for its belief, which may have been lost."""
        applied = self._applied_scan
        if not scan.paced or applied is None or scan.step != applied.step or not self._outcome:
            return []
        return [PublishBelief(self._belief(self._outcome, applied), self.pose(now_ns))]

    def _start_scan(self) -> Scan:
        """The scan at whose time a command takes effect: the last applied one."""
        if self._applied_scan is None:
            raise ValueError("no scan has arrived yet; start the robot or the recording first")
        return self._applied_scan

    def _given(self, command: SetPose, scan: Scan) -> Candidate:
        """A Gaussian cloud round the pose that a person gives."""
        self._set_poses += 1
        return candidate(
            self._filter_settings.belief.set_pose_probability,
            command.map_from_robot,
            diagonal(command.position_sigma_m, command.heading_sigma_rad),
            seed=self._filter_settings.seed,
            purpose=Purpose.GIVEN_POSE,
            entity=self._set_poses,
            step=scan.step,
            odom_from_robot=scan.odom_from_robot,
        )

    # --- succession

    def _begin(self, now_ns: int) -> list[Instruction]:
        """All has been heard: carry on from another's state, or begin anew."""
        self._succession.begun = self._changed = True
        self._placement.rule(self._succession.term)
        newest = self._succession.newest
        instructions = self._resume(newest, now_ns) if newest else []
        if not instructions:
            waiting = self._collector.oldest_scan
            if waiting is not None:
                self._begin_search(waiting)
            else:
                instructions.append(FetchScans(0, None))
            for worker in self._succession.told:
                self._placement.held(worker, (), now_ns)
        for report, worker in self._early_reports:
            self._take(report, worker)
        self._early_reports.clear()
        return instructions

    def _begin_search(self, scan: Scan) -> None:
        """The first search begins with this scan, or those that were lost just before it."""
        if self._ensemble.searches:
            return
        before = self._collector.before
        lost = 0 if before is None else scan.step - before - 1
        first = scan.step - (lost if lost <= NEVER_LATER else 0)
        self._collector.begin_after(first - 1)
        self._placement.begin(self._ensemble.begin_at(first, self._offer(scan)))
        self._changed = True

    def _offer(self, scan: Scan) -> OfferState | None:
        """Where the robot was at the end of an earlier life, as one place that is possible."""
        last = self._last_poses.get(scan.map_digest)
        probability = self._settings.last_pose_probability
        return last.offered_at(scan, probability) if last and probability > 0.0 else None

    def _resume(self, checkpoint: Checkpoint, now_ns: int) -> list[Instruction]:
        """Carry on from another's state; nothing is done if it cannot be used."""
        try:
            state = from_bytes(checkpoint.state)
        except ValueError:
            self._counters["checkpoint that cannot be read"] += 1
            return []
        digest, newest = self._placement.map_digest, self._collector.newest_scan
        if not state.ensemble.searches or (digest and digest != state.map_digest):
            self._counters["checkpoint of another map"] += bool(state.ensemble.searches)
            return []
        if newest and state.applied and newest.step < state.applied.step:
            self._counters["checkpoint of another numbering"] += 1
            return []
        self._succession.founded = checkpoint.founded
        self._restore(state, now_ns)
        for worker, told in self._succession.told.items():
            self._hear_out(worker, told, now_ns)
        search = state.ensemble.search
        first = search.first_step if search else 0
        if state.applied is not None:
            first = state.applied.step + 1
        return [FetchScans(first, None), *self._believe_again(state, now_ns)]

    def _restore(self, state: CoordinatorState, now_ns: int) -> None:
        self._ensemble.restore(state.ensemble)
        self._placement.map_digest = state.map_digest
        self._placement.restore(state.jobs, lambda job_id: self._rebuilt(job_id, state), now_ns)
        applied = state.applied
        self._collector.resume(applied.step if applied else None, state.steps_lost)
        self._steps_applied, self._set_poses = state.steps_applied, state.set_poses
        self._reports_missing = state.reports_missing
        self._counters.update(state.counters)
        self._commands_done |= state.commands_done
        self._changed = True
        if applied is not None:
            self._pose.resume(applied.stamp_ns, applied.odom_from_robot, state.age_s, now_ns)

    def _believe_again(self, state: CoordinatorState, now_ns: int) -> list[Instruction]:
        """Publish what was believed last; the one before may not have come to it."""
        if state.applied is None:
            return []
        self._applied_scan = state.applied
        self._outcome = self._ensemble.again(state.applied.step, state.missing)
        self._pose.believed(self._outcome, state.applied.odom_from_robot)
        return [PublishBelief(self._belief(self._outcome, state.applied), self.pose(now_ns))]

    def _hear_out(self, worker: str, told: Told, now_ns: int) -> list[Instruction]:
        """Take what a worker holds, and what it has reported while nobody was there."""
        self._placement.held(worker, told.holds, now_ns)
        for report in told.reports:
            self._take(report, worker)
        return []

    def _rebuilt(self, job_id: str, state: CoordinatorState) -> TrackJob:
        """A cluster whose particles were lost with its worker: drawn anew from its Gaussian."""
        assert state.applied is not None  # there are clusters only after a step
        cluster = next(c for c in state.ensemble.clusters if c.job_id == job_id)
        again = candidate(
            1.0,
            cluster.mean,
            cluster.covariance,
            seed=self._filter_settings.seed,
            purpose=Purpose.REBUILT,
            entity=cluster.cluster,
            step=state.applied.step,
            odom_from_robot=state.applied.odom_from_robot,
        )
        return TrackJob(cluster=cluster.cluster, start=again.sample, exact=False)

    def _state(self, now_ns: int) -> CoordinatorState:
        return CoordinatorState(
            version=STATE_VERSION,
            map_digest=self._placement.map_digest,
            ensemble=self._ensemble.state(),
            jobs=self._placement.state(),
            applied=_without_beams(self._applied_scan),
            missing=self._outcome.missing if self._outcome else (),
            age_s=self._pose.age_s(now_ns),
            steps_applied=self._steps_applied,
            steps_lost=self._collector.steps_lost,
            reports_missing=self._reports_missing,
            set_poses=self._set_poses,
            counters=dict(self._counters),
            commands_done=dict(list(self._commands_done.items())[-HANDED_ON_COMMANDS:]),
        )


def _without_beams(scan: Scan | None) -> Scan | None:
    empty = ArrayBlob(dtype="float32", shape=(0,), data=b"")
    return scan and msgspec.structs.replace(scan, ranges=empty)
