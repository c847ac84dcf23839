"""The coordinator's decisions: told what happened, answers what to send.

No network, no clock: events carry `now_ns`, instructions are plain objects. So a whole failure
story is a unit test.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import assert_never

from coordinator.answers import Answers
from coordinator.checkpoint import PriorPose
from coordinator.commands import carry_out
from coordinator.events import (
    CheckpointHeard,
    CommandArrived,
    Event,
    HistoryArrived,
    LinkBack,
    LinkLost,
    OdometryArrived,
    OrderAnswered,
    ReportArrived,
    ScanArrived,
    TimePassed,
    WorkerJoined,
    WorkerLeft,
    WorkerReturned,
    WorkerToldState,
)
from coordinator.failover.state_recovery import Told
from coordinator.failover.term import Term
from coordinator.instructions import (
    AnswerCommand,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishEvents,
    SendOrder,
)
from coordinator.pose.last_pose import LastPose
from coordinator.state import CoordinatorState
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from protocol.answers import CommandDone, Hypotheses, PoseAnswer, Relocalize, SetPose, Status
from protocol.job_events import JobEvents
from protocol.step_reset_detector import StepResetDetector
from protocol.steps import Scan
from protocol.work import Checkpoint, OrderAnswer, Report

NEVER_LATER = 16
"""More steps than this lost before the first scan that is heard, and nobody looks for them."""


class Coordinator:
    """All that the coordinator process decides."""

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
            term: see `Term`; raised above all that workers know.
            known: a checkpoint that was heard before the workers are asked.
            last_poses: where the robot was at the end of an earlier life, by the map's digest.
        """
        self._sender, self._settings = sender, settings
        self._last_poses = last_poses
        self._state = CoordinatorState(sender, filter_settings, settings)
        self._answers = Answers(sender, version, self._state, now_ns)
        self._term = Term(sender, term, known, now_ns)
        self._step_resets = StepResetDetector()
        self._early_reports: list[tuple[Report, str]] = []
        self._linked = True

    @property
    def outranked_by(self) -> int | None:
        """A higher term that somebody knows of: another coordinator acts, this one must not."""
        return self._term.outranked_by

    @property
    def map_digest(self) -> str:
        """Of the map in which the robot is looked for; empty before the first scan."""
        return self._state.placement.map_digest

    @property
    def begun(self) -> bool:
        """Whether it knows enough to answer."""
        return self._term.begun

    def handle(  # noqa: PLR0911, PLR0912 - a branch for each event
        self, event: Event, now_ns: int
    ) -> list[Instruction]:
        """Take in what happened, and say what to do about it, in this order.

        Args:
            event: what happened.
            now_ns: when, by the clock of all events; it never steps back.
        """
        match event:
            case ScanArrived(scan):
                return self._on_scan(scan, now_ns)
            case HistoryArrived(scans):
                return self._on_history(scans, now_ns)
            case OdometryArrived(reading):
                self._state.pose.odometry(reading.stamp_ns, reading.odom_from_robot, now_ns)
            case ReportArrived(worker, report):
                return self._on_report(report, worker, now_ns)
            case WorkerJoined(worker):
                return self._on_worker_joined(worker, now_ns)
            case WorkerToldState(worker, told):
                return self._on_worker_told(worker, told, now_ns)
            case WorkerLeft(worker):
                return self._on_worker_left(worker, now_ns)
            case WorkerReturned(worker):
                self._state.placement.returned(worker)
                return self._on_time_passed(now_ns)
            case OrderAnswered(worker, answer):
                self._on_order_answered(worker, answer)
            case CheckpointHeard(checkpoint):
                self._term.hear(checkpoint)
            case LinkLost():
                self._linked = False
            case LinkBack():
                return self._on_link_back(now_ns)
            case CommandArrived(command):
                return self._on_command(command, now_ns)
            case TimePassed():
                return self._on_time_passed(now_ns)
            case _:
                assert_never(event)
        return []

    @property
    def pose_outlives_us(self) -> bool:
        """Whether the last pose is of use to another life of ours, and that of an earlier one here.

        A recording or a simulation begins where it begins, unless a person names a folder for it.
        """
        return self._state.pose.live or bool(self._settings.state_folder)

    # --- what the robot does

    def _on_scan(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """A step's scan arrived."""
        state = self._state
        if not state.placement.map_digest:
            state.placement.map_digest = scan.map_digest
        elif scan.map_digest != state.placement.map_digest:
            state.counters["scan of another map"] += 1
            return []
        if not state.collector.take_scan(scan, now_ns):
            state.counters["scan repeated or late"] += 1
            if self.begun and self._step_resets.starts_anew(scan, state.applied_scan):
                state.count_anew(scan)
                return self._on_scan(scan, now_ns)
            return self._say_again(scan, now_ns)
        state.pose.scan(scan.stamp_ns, scan.odom_from_robot, now_ns, live=scan.live)
        if not self.begun:
            return self._on_time_passed(now_ns)
        self._begin_search(scan)
        lost = state.collector.lost_before(scan)
        return ([FetchScans(*lost)] if lost else []) + self._on_time_passed(now_ns)

    def _on_history(self, scans: Sequence[Scan], now_ns: int) -> list[Instruction]:
        """Steps of the past; a coordinator without any begins with the newest of them."""
        if self.begun and not self._state.ensemble.searches:
            self._state.collector.begin_after(scans[-1].step - 1 if scans else -1)
            scans = scans[-1:]
        return [do for scan in scans for do in self._on_scan(scan, now_ns)]

    # --- what workers do

    def _on_report(self, report: Report, worker: str, now_ns: int) -> list[Instruction]:
        """A worker's job took a step."""
        if self.begun:
            self._state.on_report(report, worker)
        else:
            self._early_reports.append((report, worker))
        return self._on_time_passed(now_ns)

    def _on_worker_joined(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token appeared."""
        missed = self._state.placement.misses(name)
        silent_until_ns = self._term.joined(name, now_ns, missed=missed)
        self._state.placement.joined(name, silent_until_ns)
        self._state.changed = True  # a newcomer has heard no checkpoint yet
        return self._on_time_passed(now_ns)

    def _on_worker_told(self, name: str, told: Told, now_ns: int) -> list[Instruction]:
        """A worker says what it does, and what the last coordinator had decided."""
        if not self._state.placement.has(name):
            return []
        self._term.answered(name, told)
        if not self.begun:
            return self._on_time_passed(now_ns)
        newest, resumed = told.checkpoint, list[Instruction]()
        if newest is not None and newest.founded and not self._term.founded:
            resumed = self._resume(newest, now_ns)
        if not resumed:
            self._hear_out(name, told, now_ns)
        return resumed + self._on_time_passed(now_ns)

    def _on_worker_left(self, name: str, now_ns: int) -> list[Instruction]:
        """A worker's liveliness token is gone."""
        self._state.placement.left(name)
        self._term.left(name)
        self._state.changed = True
        return self._on_time_passed(now_ns)

    def _on_order_answered(self, worker: str, answer: OrderAnswer) -> None:
        """A worker took an order, or says why not."""
        if answer.problem:
            self._state.counters["order refused"] += 1  # the worker's log says why
        self._term.hear_term(answer.term)
        self._state.placement.answered(worker, answer)

    # --- what others do

    def _on_link_back(self, now_ns: int) -> list[Instruction]:
        """Our own link is back: steps under way get their whole deadline again."""
        self._linked = True
        self._state.collector.wait_anew(now_ns)
        return self._on_time_passed(now_ns)

    def _on_command(self, command: SetPose | Relocalize, now_ns: int) -> list[Instruction]:
        """Done once for each id; others know of it before it is answered."""
        instructions: list[Instruction] = []
        if command.command_id not in self._state.commands_done:
            if carry_out(command, self._state):
                self._term.founded = True
                instructions += self._believed(now_ns)
            instructions += self._on_time_passed(now_ns)
        problem = self._state.commands_done[command.command_id]
        return [*instructions, AnswerCommand(CommandDone(sender=self._sender, problem=problem))]

    def _on_time_passed(self, now_ns: int) -> list[Instruction]:
        """Apply the steps that are due and tell workers what is news to them."""
        if not self._linked or self.outranked_by is not None:
            return []
        state, instructions = self._state, list[Instruction](self._term.questions(now_ns))
        if not self.begun:
            if not self._term.may_begin(now_ns):
                return instructions
            instructions += self._begin(now_ns)
        while ready := state.collector.ready(
            state.placement.waited_for(state.ensemble.expected), state.placement.placed_ns, now_ns
        ):
            state.apply(ready, now_ns)
            instructions += self._believed(now_ns)
        orders = state.placement.orders(now_ns)
        if state.changed or orders:
            self._term.founded |= len(state.ensemble.clusters) > 0
            first: list[Instruction] = [self._term.hand_on(state.state(now_ns), now_ns)]
            state.changed = False
        else:
            first = list(self._term.sign_of_life(now_ns))
        return [*first, *(SendOrder(worker, order) for worker, order in orders), *instructions]

    # --- answers

    def pose(self, now_ns: int) -> PoseAnswer:
        """Where the robot is now."""
        return self._answers.pose(now_ns)

    def hypotheses(self, now_ns: int) -> Hypotheses:
        """All places with their probabilities."""
        return self._answers.hypotheses(now_ns)

    def events(self) -> JobEvents:
        """What has begun and ended of late, and why."""
        return self._answers.events()

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """How the system is; `counters` are those of the process around."""
        return self._answers.status(now_ns, counters)

    def _believed(self, now_ns: int) -> list[Instruction]:
        """Tell what is believed now, and first what has begun and ended."""
        belief = self._answers.belief()
        if belief is None:
            return []
        events = self._answers.new_events()
        told: list[Instruction] = [PublishEvents(events)] if events is not None else []
        return [*told, PublishBelief(belief, self.pose(now_ns))]

    def _say_again(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """A step that comes again waits for its belief, which may have been lost."""
        applied = self._state.applied_scan
        if not scan.paced or applied is None or scan.step != applied.step:
            return []
        return self._believed(now_ns)

    # --- the beginning

    def _begin(self, now_ns: int) -> list[Instruction]:
        """All has been heard: carry on from another's state, or begin anew."""
        self._term.begun = self._state.changed = True
        self._answers.term = self._term.term
        self._state.placement.rule(self._term.term)
        newest = self._term.newest
        instructions = self._resume(newest, now_ns) if newest is not None else []
        if not instructions:
            for worker in self._term.told:
                self._state.placement.held(worker, (), now_ns)
            waiting = self._state.collector.oldest_scan
            if waiting is not None:
                self._begin_search(waiting)
            else:
                instructions.append(FetchScans(0, None))
        for report, worker in self._early_reports:
            self._state.on_report(report, worker)
        self._early_reports.clear()
        return instructions

    def _begin_search(self, scan: Scan) -> None:
        """The first search begins with this scan, or those that were lost just before it."""
        if self._state.ensemble.searches:
            return
        before = self._state.collector.before
        lost = 0 if before is None else scan.step - before - 1
        first = scan.step - (lost if lost <= NEVER_LATER else 0)
        self._state.begin_search(first, self._prior_pose(scan))

    def _prior_pose(self, scan: Scan) -> PriorPose | None:
        """Where the robot was at the end of an earlier life, as one place that is possible."""
        last = self._last_poses.get(scan.map_digest) if self.pose_outlives_us else None
        probability = self._settings.last_pose_probability
        return last.offered_at(scan, probability) if last and probability > 0.0 else None

    def _resume(self, checkpoint: Checkpoint, now_ns: int) -> list[Instruction]:
        """Carry on from another's state; nothing is done if it cannot be used.

        The belief that was last is published again: the one before may not have come to it.
        """
        next_step = self._state.resume(checkpoint, now_ns)
        if next_step is None:
            return []
        self._term.founded = checkpoint.founded
        for worker, told in self._term.told.items():
            self._hear_out(worker, told, now_ns)
        return [FetchScans(next_step, None), *self._believed(now_ns)]

    def _hear_out(self, worker: str, told: Told, now_ns: int) -> None:
        """Take what a worker holds, and what it has reported while nobody was there."""
        self._state.placement.held(worker, told.holds, now_ns)
        for report in told.reports:
            self._state.on_report(report, worker)
