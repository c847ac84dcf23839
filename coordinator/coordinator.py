"""The coordinator's decisions: events and the time in, instructions out.

No network and no clock, so a unit test can replay any failure of a worker or a network.
"""

from collections import Counter
from collections.abc import Sequence
from typing import assert_never

import msgspec

from coordinator import events
from coordinator.belief.outcome import belief_after
from coordinator.checkpoint import to_bytes
from coordinator.free_ground import FreeGround
from coordinator.instructions import (
    AnswerCommand,
    FetchMap,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
    PublishEvents,
    SendOrder,
)
from coordinator.recovery import LastPlace, StateRecovery, Succession, Term
from coordinator.state import CoordinatorState
from particle_filter.settings import FilterSettings
from process_runtime.settings import BridgeSettings, CoordinatorSettings
from protocol.answers import (
    Belief,
    CommandDone,
    Hypotheses,
    PoseAnswer,
    Relocalize,
    SetPose,
    Status,
)
from protocol.job_events import JobEvents, NumberedEvent
from protocol.step_reset_detector import StepResetDetector, is_huge_jump
from protocol.steps import Scan
from protocol.work import Checkpoint, OrderAnswer

SIGN_OF_LIFE_NS = 400_000_000
"""An unchanged state is published again after this time [ns]."""


class CheckpointSeries:
    """Numbers the states of one coordinator, and repeats the last one as a sign of life."""

    def __init__(self, sender: str) -> None:
        self._sender = sender
        self._last: Checkpoint | None = None
        self._last_ns = 0

    def next(
        self, state: bytes, *, term: int, step: int, founded: bool, now_ns: int
    ) -> PublishCheckpoint:
        """Return a changed state, which is published before anything that follows from it.

        Args:
            state: of the coordinator, encoded.
            term: of the coordinator.
            step: the last one applied; -1: none.
            founded: see `Checkpoint`.
            now_ns: by the clock of all events.
        """
        serial = self._last.serial + 1 if self._last else 0
        self._last_ns = now_ns
        self._last = Checkpoint(
            sender=self._sender, term=term, serial=serial, step=step, founded=founded, state=state
        )
        return PublishCheckpoint(self._last)

    def sign_of_life(self, now_ns: int) -> list[PublishCheckpoint]:
        """Return the last state again, if it is due."""
        if self._last is None or now_ns - self._last_ns < SIGN_OF_LIFE_NS:
            return []
        self._last_ns = now_ns
        return [PublishCheckpoint(self._last)]


class Answers:
    """Builds publications and query answers from the coordinator's state.

    Args:
        sender: name of the process.
        version: of the software.
        state: of the coordinator.
        term: of the coordinator.
        now_ns: when it was started.
    """

    def __init__(
        self, sender: str, version: str, state: CoordinatorState, term: Term, now_ns: int
    ) -> None:
        self._sender, self._version, self._state, self._term = sender, version, state, term
        self._started_ns = now_ns

    def pose(self, now_ns: int) -> PoseAnswer:
        answer = self._state.pose.answer(now_ns, len(self._state.placement.delivery.workers))
        return msgspec.structs.replace(answer, term=self._term.number)

    def hypotheses(self, now_ns: int) -> Hypotheses:
        return Hypotheses(
            sender=self._sender, pose=self.pose(now_ns), hypotheses=self._state.pose.hypotheses()
        )

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """Return the status; `counters` are those of the process."""
        pose = self.pose(now_ns)
        return Status(
            sender=self._sender,
            version=self._version,
            state=pose.state,
            freshness=pose.freshness,
            age_s=pose.age_s,
            scan_age_s=pose.scan_age_s,
            step=pose.step,
            steps_applied=self._state.steps_applied,
            steps_lost=self._state.collector.steps_lost,
            reports_missing=self._state.reports_missing,
            map_digest=self._state.map_digest,
            clusters=len(self._state.ensemble.clusters),
            searching=self._state.outcome.searching if self._state.outcome else False,
            search_progress=self._state.outcome.search_progress if self._state.outcome else 0.0,
            workers=self._state.placement.workers,
            counters=dict(sorted((self._state.counters + Counter(counters)).items())),
            uptime_s=(now_ns - self._started_ns) / 1e9,
            term=self._term.number,
            newest_step=self._state.newest_step,
            settings=self._state.newest_settings,
            overloaded=self._state.overload.is_overloaded,
        )

    def events(self) -> JobEvents:
        """Return the last events of clusters and searches."""
        return self._told(tuple(self._state.event_log.kept))

    def publication(self, now_ns: int) -> list[PublishEvents | PublishBelief]:
        """Return what is published after a step or a command; nothing before the first step.

        Events are published before the belief to which they belong.
        """
        belief = self._belief()
        if belief is None:
            return []
        news = self._state.event_log.news()
        told = [PublishEvents(self._told(news))] if news else []
        return [*told, PublishBelief(belief, self.pose(now_ns))]

    def _told(self, events: tuple[NumberedEvent, ...]) -> JobEvents:
        return JobEvents(sender=self._sender, events=events, term=self._term.number)

    def _belief(self) -> Belief | None:
        """Return the belief after the last step or command; None before the first."""
        outcome, scan = self._state.outcome, self._state.collector.applied
        if outcome is None or scan is None:
            return None
        return belief_after(scan, outcome, self._sender, self._term.number)


STEPS_AT_ONCE = 4
"""More steps wait for the next event, so that orders and answers are sent in between."""


class Coordinator:
    """Decides everything while the process recovers and leads; see `Replica`."""

    def __init__(
        self,
        sender: str,
        filter_settings: FilterSettings,
        settings: CoordinatorSettings,
        version: str,
        now_ns: int,
        *,
        bridge: BridgeSettings = BridgeSettings(),  # noqa: B008 - frozen
        term: int = 0,
        known: Checkpoint | None = None,
        usual_delay_ns: int | None = None,
        kept: Checkpoint | None = None,
    ) -> None:
        """Know nothing yet.

        Args:
            sender: name of the process.
            filter_settings: the filter's numbers.
            settings: the coordinator's.
            version: of the software.
            now_ns: by the clock of all events.
            bridge: the bridge's, for its gate.
            term: see `Term`; raised above all that workers know.
            known: the newest state received from another coordinator.
            usual_delay_ns: see `PoseTracker.begin`; None: unknown, or the robot is not live.
            kept: a checkpoint from the file of this machine, which `state_in` accepts.
        """
        self._sender = sender
        self._term = Term(term, known, kept)
        self._state = CoordinatorState(sender, filter_settings, settings, bridge)
        if usual_delay_ns is not None:
            self._state.pose.begin(usual_delay_ns, now_ns)
        self._answers = Answers(sender, version, self._state, self._term, now_ns)
        self._take_over = Succession(
            self._state,
            self._term,
            StateRecovery(sender, known, kept, now_ns),
            self._answers.publication,
            LastPlace.of(kept) if kept else None,
            settings.last_pose_probability,
        )
        self._checkpoints = CheckpointSeries(sender)
        self._step_resets = StepResetDetector()
        self._linked = True

    @property
    def outranked_by(self) -> int | None:
        """The higher term of another coordinator, which has deposed this one."""
        return self._term.outranked_by

    @property
    def map_digest(self) -> str:
        """Digest of the map in which the robot is localized; empty before the first scan."""
        return self._state.map_digest

    @property
    def filter_settings(self) -> FilterSettings:
        """The filter's numbers, as workers get them."""
        return self._state.ensemble.settings

    @property
    def begun(self) -> bool:
        """Whether recovery is over."""
        return self._term.begun

    def handle(  # noqa: PLR0911, PLR0912 - a branch for each event
        self, event: events.Event, now_ns: int
    ) -> list[Instruction]:
        """Take what happened; return what to do, in this order.

        Args:
            event: what happened.
            now_ns: when, by the clock of all events; it never steps back.
        """
        match event:
            case events.ScanArrived(scan):
                return self._on_scan(scan, now_ns)
            case events.HistoryArrived(scans):
                return self._on_history(scans, now_ns)
            case events.OdometryArrived(reading):
                self._state.pose.odometry(reading.stamp_ns, reading.odom_from_robot, now_ns)
            case events.ReportArrived(worker, report):
                self._take_over.on_report(report, worker)
                # Nine in ten reports complete nothing; what time brings, the next event does.
                awaits_more = self.begun and self._state.awaits_reports
                return [] if awaits_more else self._on_time_passed(now_ns)
            case events.WorkerJoined(worker):
                self._take_over.on_worker_joined(worker, now_ns)
                return self._on_time_passed(now_ns)
            case events.WorkerToldState(worker, told):
                return self._on_worker_told(worker, told, now_ns)
            case events.WorkerLeft(worker):
                self._take_over.on_worker_left(worker)
                return self._on_time_passed(now_ns)
            case events.WorkerReturned(worker):
                self._state.placement.delivery.repeat(worker)
                return self._on_time_passed(now_ns)
            case events.OrderAnswered(worker, answer):
                self._on_order_answered(worker, answer, now_ns)
            case events.CheckpointHeard(checkpoint):
                self._take_over.on_checkpoint(checkpoint)
            case events.LinkLost():
                self._linked = False
            case events.LinkBack():
                self._linked = True
                self._state.collector.wait_anew(now_ns)
                return self._on_time_passed(now_ns)
            case events.CommandArrived(command):
                return self._on_command(command, now_ns)
            case events.MapArrived(ground):
                return self._on_map_arrived(ground, now_ns)
            case events.TimePassed():
                return self._on_time_passed(now_ns)
            case _:
                assert_never(event)
        return []

    # --- what the robot does

    def _on_scan(self, scan: Scan, now_ns: int, *, fetched: bool = False) -> list[Instruction]:
        state = self._state
        if not state.on_map(scan):
            return []
        newest = state.collector.newest_scan or state.collector.applied
        if is_huge_jump(scan, newest):
            state.counters["scan far ahead"] += 1
            return self._on_stray_scan(scan, newest, now_ns, fetched=fetched)
        if not state.collector.on_scan(scan, now_ns):
            state.counters["scan repeated or late"] += 1
            return self._on_stray_scan(scan, state.collector.applied, now_ns, fetched=fetched)
        self._step_resets.reset()
        pose, stamp_ns = state.pose, scan.stamp_ns
        pose.scan(stamp_ns, scan.odom_from_robot, now_ns, live=scan.live, fetched=fetched)
        if not self.begun:
            return self._on_time_passed(now_ns)
        self._take_over.begin_search(scan)
        lost = state.collector.lost_before(scan)
        return ([FetchScans(*lost)] if lost else []) + self._on_time_passed(now_ns)

    def _on_stray_scan(
        self, scan: Scan, newest: Scan | None, now_ns: int, *, fetched: bool
    ) -> list[Instruction]:
        """Handle a scan that does not continue the count of steps, which ends with `newest`."""
        if self.begun and not fetched and self._step_resets.on_other_scan(scan, newest):
            self._step_resets.reset()
            self._state.count_anew(scan)
            return self._on_scan(scan, now_ns)
        return self._say_again(scan, now_ns)

    def _on_history(self, scans: Sequence[Scan], now_ns: int) -> list[Instruction]:
        """Handle fetched scans; a coordinator without any begins with the newest of them."""
        if self.begun and not self._state.ensemble.searches:
            self._state.collector.begin_after(scans[-1].step - 1 if scans else -1)
            scans = scans[-1:]
        return [do for scan in scans for do in self._on_scan(scan, now_ns, fetched=True)]

    def _say_again(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """Publish the belief of a repeated step: the bridge waits, so it may have been lost."""
        applied = self._state.collector.applied
        if not scan.lockstep or applied is None or scan.step != applied.step:
            return []
        return [*self._answers.publication(now_ns)]

    # --- what workers do

    def _on_worker_told(
        self, worker: str, told: events.WorkerSnapshot, now_ns: int
    ) -> list[Instruction]:
        if worker not in self._state.placement.delivery:
            return []
        resumed = self._take_over.on_worker_told(worker, told, now_ns)
        return resumed + self._on_time_passed(now_ns)

    def _on_order_answered(self, worker: str, answer: OrderAnswer, now_ns: int) -> None:
        if answer.problem:
            self._state.counters["order refused"] += 1  # the worker's log says why
        self._take_over.on_worker_term(answer.term, now_ns)
        self._state.placement.delivery.answered(worker, answer)

    # --- what others do

    def _on_command(self, command: SetPose | Relocalize, now_ns: int) -> list[Instruction]:
        """Carry out a command once for each id; its effects are published before the answer."""
        instructions: list[Instruction] = []
        commands = self._state.commands
        if commands.problem(command.command_id) is None:
            if self._state.carry_out(command):
                instructions += self._answers.publication(now_ns)
            instructions += self._on_time_passed(now_ns)
        problem = commands.problem(command.command_id) or ""
        return [*instructions, AnswerCommand(CommandDone(sender=self._sender, problem=problem))]

    def _on_map_arrived(self, ground: FreeGround, now_ns: int) -> list[Instruction]:
        """Accept or refuse a given pose that waited for the map."""
        believed = self._state.on_map_arrived(ground)
        published = self._answers.publication(now_ns) if believed else []
        return [*published, *self._on_time_passed(now_ns)]

    def _on_time_passed(self, now_ns: int) -> list[Instruction]:
        """Apply the steps that are due, and send workers their orders.

        A changed state is published before the orders and beliefs that follow from it.
        """
        if not self._linked or self.outranked_by is not None:
            return []
        instructions = self._take_over.proceed(now_ns)
        if not self.begun:
            return instructions
        for _ in range(STEPS_AT_ONCE):
            ready = self._state.ready(now_ns)
            if ready is None:
                break
            self._state.apply(ready, now_ns)
            instructions += self._answers.publication(now_ns)
        orders = self._state.placement.orders(
            term=self._term.number,
            map_digest=self.map_digest,
            now_ns=now_ns,
            newest_step=self._state.newest_step,
        )
        if self._state.wants_map(now_ns):
            instructions.append(FetchMap())
        first = self._checkpoint(now_ns, needed=self._state.changed or bool(orders))
        return [*first, *(SendOrder(worker, order) for worker, order in orders), *instructions]

    def _checkpoint(self, now_ns: int, *, needed: bool) -> list[PublishCheckpoint]:
        """Return the state if it changed, or as a sign of life."""
        if not needed:
            return self._checkpoints.sign_of_life(now_ns)
        state = self._state.hand_on(now_ns)
        applied = state.collector.applied
        checkpoint = self._checkpoints.next(
            to_bytes(state),
            term=self._term.number,
            step=applied.step if applied else -1,
            founded=self._state.founded,
            now_ns=now_ns,
        )
        return [checkpoint]

    # --- answers

    def pose(self, now_ns: int) -> PoseAnswer:
        return self._answers.pose(now_ns)

    def hypotheses(self, now_ns: int) -> Hypotheses:
        return self._answers.hypotheses(now_ns)

    def events(self) -> JobEvents:
        """Return the last events of clusters and searches."""
        return self._answers.events()

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """Return the status; `counters` are those of the process."""
        return self._answers.status(now_ns, counters)
