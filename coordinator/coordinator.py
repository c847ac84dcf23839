"""The coordinator's decisions: events and the time in, instructions out.

No network and no clock, so a unit test can replay any failure of a worker or a network.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import assert_never

import msgspec
from msgspec import field

from coordinator import events
from coordinator.belief.outcome import belief_after
from coordinator.belief.prior_pose import PriorPose
from coordinator.checkpoint import to_bytes
from coordinator.events import WorkerSnapshot
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
from coordinator.part import Part
from coordinator.recovery import ORDERS_AFTER_NS, LastPlace, StateRecovery, Term
from coordinator.state import CoordinatorState
from coordinator.step_collector import is_bulky, without_snapshot
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
from protocol.work import Checkpoint, OrderAnswer, Report, SearchReport

SIGN_OF_LIFE_NS = 400_000_000
"""An unchanged state is published again after this time [ns]."""


class CheckpointSeries(Part):
    """Numbers the states of one coordinator, and repeats the last one as a sign of life."""

    sender: str
    last: Checkpoint | None = None
    last_ns: int = 0
    """When the last state was published [ns]."""

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
        serial = self.last.serial + 1 if self.last else 0
        self.last_ns = now_ns
        self.last = Checkpoint(
            sender=self.sender, term=term, serial=serial, step=step, founded=founded, state=state
        )
        return PublishCheckpoint(self.last)

    def sign_of_life(self, now_ns: int) -> list[PublishCheckpoint]:
        """Return the last state again, if it is due."""
        if self.last is None or now_ns - self.last_ns < SIGN_OF_LIFE_NS:
            return []
        self.last_ns = now_ns
        return [PublishCheckpoint(self.last)]


STEPS_AT_ONCE = 4
"""More steps wait for the next event, so that orders and answers are sent in between."""
NEVER_LATER = 16
"""If more steps were lost before the first scan received, they are not requested."""
EARLY_REPORTS, EARLY_BULKY_REPORTS = 10_000, 256
"""Most reports kept before the beginning, and most of them with particles of places."""


class Coordinator(Part):
    """A coordinator that recovers or leads: takes events, returns instructions; see `Replica`."""

    sender: str
    """Name of the process."""
    version: str
    """Version of the software."""
    started_ns: int
    """When it was started, by the clock of all events."""
    term: Term
    recovery: StateRecovery
    state: CoordinatorState
    checkpoints: CheckpointSeries
    last_place: LastPlace | None = None
    """The robot's place when the system last ran; None: unknown."""
    early_reports: list[tuple[Report, str]] = []
    """Reports and their workers before the beginning, when it is unknown whether they count."""
    step_resets: StepResetDetector = field(default_factory=StepResetDetector)
    linked: bool = True

    @classmethod
    def of(
        cls,
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
    ) -> "Coordinator":
        """Return a coordinator that has received no event.

        Args:
            sender: name of the process.
            filter_settings: of all jobs.
            settings: of the coordinator.
            version: of the software.
            now_ns: by the clock of all events.
            bridge: settings of the bridge; its gate defines a step.
            term: see `Term`; raised above all that workers know.
            known: the newest state received from another coordinator.
            usual_delay_ns: see `PoseTracker.begin`; None: unknown, or the robot is not live.
            kept: a checkpoint from the file of this machine, which `state_in` accepts.
        """
        made = cls(
            sender,
            version,
            now_ns,
            Term.of(term, known, kept),
            StateRecovery(sender, now_ns, [known] if known else [], kept),
            CoordinatorState.of(sender, filter_settings, settings, bridge),
            CheckpointSeries(sender),
            LastPlace.of(kept) if kept else None,
        )
        if usual_delay_ns is not None:
            made.state.pose.begin(usual_delay_ns, now_ns)
        return made

    @property
    def outranked_by(self) -> int | None:
        """The higher term of another coordinator, which has deposed this one."""
        return self.term.outranked_by

    @property
    def map_digest(self) -> str:
        """Digest of the map in which the robot is localized; empty before the first scan."""
        return self.state.map_digest

    @property
    def filter_settings(self) -> FilterSettings:
        """The filter's settings that hold at the applied step."""
        return self.state.ensemble.settings

    @property
    def begun(self) -> bool:
        """Whether recovery is over."""
        return self.term.begun

    def handle(  # noqa: PLR0911, PLR0912 - a branch for each event
        self, event: events.Event, now_ns: int
    ) -> list[Instruction]:
        """Process an event; return instructions to carry out in this order.

        Args:
            event: the event.
            now_ns: its time, by the clock of all events, which never steps back [ns].
        """
        match event:
            case events.ScanArrived(scan):
                return self._on_scan(scan, now_ns)
            case events.HistoryArrived(scans):
                return self._on_history(scans, now_ns)
            case events.OdometryArrived(reading):
                self.state.pose.odometry(reading.stamp_ns, reading.odom_from_robot, now_ns)
            case events.ReportArrived(worker, report):
                self._on_report(report, worker)
                # Nine in ten reports complete nothing; what time brings, the next event does.
                awaits_more = self.begun and self.state.awaits_reports
                return [] if awaits_more else self._on_time_passed(now_ns)
            case events.WorkerJoined(worker):
                self._on_worker_joined(worker, now_ns)
                return self._on_time_passed(now_ns)
            case events.WorkerToldState(worker, told):
                return self._on_worker_told(worker, told, now_ns)
            case events.WorkerLeft(worker):
                self._on_worker_left(worker)
                return self._on_time_passed(now_ns)
            case events.WorkerReturned(worker):
                self.state.placement.delivery.repeat(worker)
                return self._on_time_passed(now_ns)
            case events.OrderAnswered(worker, answer):
                self._on_order_answered(worker, answer, now_ns)
            case events.CheckpointHeard(checkpoint):
                self._on_checkpoint(checkpoint)
            case events.LinkLost():
                self.linked = False
            case events.LinkBack():
                self.linked = True
                self.state.collector.wait_anew(now_ns)
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
        state = self.state
        if not state.on_map(scan):
            return []
        newest = state.collector.newest_scan or state.collector.applied
        if is_huge_jump(scan, newest):
            state.count("scan far ahead")
            return self._on_stray_scan(scan, newest, now_ns, fetched=fetched)
        if not state.collector.on_scan(scan, now_ns):
            state.count("scan repeated or late")
            return self._on_stray_scan(scan, state.collector.applied, now_ns, fetched=fetched)
        self.step_resets.reset()
        pose, stamp_ns = state.pose, scan.stamp_ns
        pose.scan(stamp_ns, scan.odom_from_robot, now_ns, live=scan.live, fetched=fetched)
        if not self.begun:
            return self._on_time_passed(now_ns)
        self._begin_search(scan)
        lost = state.collector.lost_before(scan)
        return ([FetchScans(*lost)] if lost else []) + self._on_time_passed(now_ns)

    def _on_stray_scan(
        self, scan: Scan, newest: Scan | None, now_ns: int, *, fetched: bool
    ) -> list[Instruction]:
        """Handle a scan that does not continue the count of steps after `newest`."""
        if self.begun and not fetched and self.step_resets.on_other_scan(scan, newest):
            self.step_resets.reset()
            self.state.count_anew(scan)
            return self._on_scan(scan, now_ns)
        return self._say_again(scan, now_ns)

    def _on_history(self, scans: Sequence[Scan], now_ns: int) -> list[Instruction]:
        """Handle fetched scans; a coordinator without scans begins with the newest one."""
        if self.begun and not self.state.ensemble.searches:
            self.state.collector.begin_after(scans[-1].step - 1 if scans else -1)
            scans = scans[-1:]
        return [do for scan in scans for do in self._on_scan(scan, now_ns, fetched=True)]

    def _say_again(self, scan: Scan, now_ns: int) -> list[Instruction]:
        """Publish the belief of a repeated step: the bridge waits, so it may have been lost."""
        applied = self.state.collector.applied
        if not scan.lockstep or applied is None or scan.step != applied.step:
            return []
        return [*self._publication(now_ns)]

    # --- what workers do

    def _on_worker_joined(self, worker: str, now_ns: int) -> None:
        """Ask a new worker before it gets orders, unless it can know nothing new."""
        is_missed = self.state.placement.jobs.misses(worker)
        is_asked = is_missed or not (self.begun and self.state.founded)
        if is_asked:
            self.recovery.expect(worker)
        self.state.on_worker_joined(worker, now_ns + ORDERS_AFTER_NS if is_asked else 0)

    def _on_worker_left(self, worker: str) -> None:
        self.recovery.forget(worker)
        self.state.on_worker_left(worker)

    def _on_worker_told(self, worker: str, told: WorkerSnapshot, now_ns: int) -> list[Instruction]:
        """Take a worker's answer: its jobs, its reports, and the terms that it knows."""
        if worker not in self.state.placement.delivery:
            return []
        self._on_worker_term(told.term, now_ns)
        if told.term <= self.term.number:
            self.recovery.answered(worker, told)
        if not self.begun:
            return self._on_time_passed(now_ns)
        resumed = list[Instruction]()
        if not self.state.founded:
            founded = [one for one in self.recovery.checkpoints if one.founded]
            resumed = self._resume_best(founded, now_ns)
        self.recovery.forget_checkpoints()
        if not resumed:
            self._take_work_of(worker, told, now_ns)
        return resumed + self._on_time_passed(now_ns)

    def _on_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Take another coordinator's state."""
        self.term.hear(checkpoint.term)
        if not self.begun:
            self.recovery.hear(checkpoint)

    def _on_worker_term(self, number: int, now_ns: int) -> None:
        """Take a worker's highest term; ask all again if this coordinator's was raised."""
        if self.term.on_worker_term(number, now_ns):
            self.recovery.ask_all_again()

    def _on_report(self, report: Report, worker: str) -> None:
        """Take a report; before the beginning it is unknown whether it counts."""
        if self.begun:
            self.state.on_report(report, worker)
            return
        early = self.early_reports
        bulky = sum(is_bulky(waiting) for waiting, _ in early) if is_bulky(report) else 0
        if len(early) < EARLY_REPORTS and bulky < EARLY_BULKY_REPORTS:
            early.append((without_snapshot(report), worker))
        else:
            self.state.count("report far ahead, or beside too many")

    def _on_order_answered(self, worker: str, answer: OrderAnswer, now_ns: int) -> None:
        if answer.problem:
            self.state.count("order refused")  # the worker's log says why
        self._on_worker_term(answer.term, now_ns)
        self.state.placement.delivery.answered(worker, answer)

    # --- what others do

    def _on_command(self, command: SetPose | Relocalize, now_ns: int) -> list[Instruction]:
        """Carry out a command once for each id; its effects are published before the answer."""
        instructions: list[Instruction] = []
        commands = self.state.commands
        if commands.problem(command.command_id) is None:
            if self.state.carry_out(command):
                instructions += self._publication(now_ns)
            instructions += self._on_time_passed(now_ns)
        problem = commands.problem(command.command_id) or ""
        return [*instructions, AnswerCommand(CommandDone(sender=self.sender, problem=problem))]

    def _on_map_arrived(self, ground: FreeGround, now_ns: int) -> list[Instruction]:
        """Accept or refuse a given pose that waited for the map."""
        believed = self.state.on_map_arrived(ground)
        published = self._publication(now_ns) if believed else []
        return [*published, *self._on_time_passed(now_ns)]

    def _on_time_passed(self, now_ns: int) -> list[Instruction]:
        """Apply the steps that are due, and send workers their orders.

        A changed state is published before the orders and beliefs that follow from it.
        """
        if not self.linked or self.outranked_by is not None:
            return []
        instructions = self._proceed(now_ns)
        if not self.begun:
            return instructions
        for _ in range(STEPS_AT_ONCE):
            ready = self.state.ready(now_ns)
            if ready is None:
                break
            self.state.apply(ready, now_ns)
            instructions += self._publication(now_ns)
        orders = self.state.placement.orders(
            term=self.term.number,
            map_digest=self.map_digest,
            now_ns=now_ns,
            newest_step=self.state.newest_step,
        )
        if self.state.wants_map(now_ns):
            instructions.append(FetchMap())
        first = self._checkpoint(now_ns, needed=self.state.changed or bool(orders))
        return [*first, *(SendOrder(worker, order) for worker, order in orders), *instructions]

    def _checkpoint(self, now_ns: int, *, needed: bool) -> list[PublishCheckpoint]:
        """Return the state if it changed, or as a sign of life."""
        if not needed:
            return self.checkpoints.sign_of_life(now_ns)
        state = self.state.hand_on(now_ns)
        applied = state.collector.applied
        checkpoint = self.checkpoints.next(
            to_bytes(state),
            term=self.term.number,
            step=applied.step if applied else -1,
            founded=self.state.founded,
            now_ns=now_ns,
        )
        return [checkpoint]

    # --- the beginning

    def _proceed(self, now_ns: int) -> list[Instruction]:
        """Query the workers that are due; begin to lead once waiting for answers is over."""
        applied = self.state.collector.applied
        own_step = applied.step if applied else -1
        questions = self.recovery.questions(self.term.number, own_step, now_ns)
        instructions = list[Instruction](questions)
        if self.begun and self.term.rises_above_workers(now_ns):
            self.state.count("term raised above a worker's")
            self.state.changed = True  # the term is a part of what is published
        if not self.begun and self.recovery.is_over(now_ns):
            instructions += self._begin(now_ns)
        if self.begun and self.state.founded:
            self.recovery.forget_told()
        return instructions

    def _begin(self, now_ns: int) -> list[Instruction]:
        """Continue from a state, or search for the robot."""
        self.term.begun = True
        instructions = self._resume_best(self.recovery.checkpoints, now_ns)
        self.recovery.forget_checkpoints()
        if not instructions:
            for worker in self.recovery.told:
                self.state.placement.held(worker, (), now_ns)
            waiting = self.state.collector.oldest_scan
            if waiting is not None:
                self._begin_search(waiting)
            else:
                instructions.append(FetchScans(0, None))
        for report, worker in self.early_reports:
            self.state.on_report(report, worker)
        self.early_reports.clear()
        return instructions

    def _begin_search(self, scan: Scan) -> None:
        """Begin the first search with this scan, or with those that were lost just before it."""
        if self.state.ensemble.searches:
            return
        before = self.state.collector.before
        lost = 0 if before is None else scan.step - before - 1
        first = scan.step - (lost if lost <= NEVER_LATER else 0)
        self.state.begin_search(first, self._prior_pose(scan))

    def _prior_pose(self, scan: Scan) -> PriorPose | None:
        """Return the last place, if it may be one hypothesis."""
        last, probability = self.last_place, self.state.settings.last_pose_probability
        if last is None or probability == 0.0 or self.state.commands.forgets:
            return None
        if last.map_digest != scan.map_digest or not self.state.place_counts(last.live):
            return None
        return last.as_prior_at(scan, probability)

    def _resume_best(self, checkpoints: Iterable[Checkpoint], now_ns: int) -> list[Instruction]:
        """Continue from the first state that can be used; do nothing if none can."""
        resumed = (self._resume(checkpoint, now_ns) for checkpoint in checkpoints)
        return next(filter(None, resumed), [])

    def _resume(self, checkpoint: Checkpoint, now_ns: int) -> list[Instruction]:
        """Continue from a state; do nothing if it cannot be used.

        The last belief is published again, as its coordinator may have died before it was.
        """
        next_step = self.state.resume(checkpoint, now_ns)
        if next_step is None:
            return []
        for worker, told in self.recovery.told.items():
            self._take_work_of(worker, told, now_ns)
        return [FetchScans(next_step, None), *self._publication(now_ns)]

    def _take_work_of(self, worker: str, told: WorkerSnapshot, now_ns: int) -> None:
        """Take a worker's jobs, and the reports since the state."""
        self.state.placement.held(worker, told.holds, now_ns)
        applied = self.state.collector.applied
        for report in told.reports:
            if isinstance(report, SearchReport) or applied is None or report.step > applied.step:
                self.state.on_report(report, worker, is_told_late=True)

    # --- answers

    def pose(self, now_ns: int) -> PoseAnswer:
        answer = self.state.pose.answer(now_ns, len(self.state.placement.delivery.workers))
        return msgspec.structs.replace(answer, term=self.term.number)

    def hypotheses(self, now_ns: int) -> Hypotheses:
        return Hypotheses(
            sender=self.sender, pose=self.pose(now_ns), hypotheses=self.state.pose.hypotheses()
        )

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """Return the status; `counters` are those of the process."""
        pose = self.pose(now_ns)
        return Status(
            sender=self.sender,
            version=self.version,
            state=pose.state,
            freshness=pose.freshness,
            age_s=pose.age_s,
            scan_age_s=pose.scan_age_s,
            step=pose.step,
            steps_applied=self.state.steps_applied,
            steps_lost=self.state.collector.steps_lost,
            reports_missing=self.state.reports_missing,
            map_digest=self.state.map_digest,
            clusters=len(self.state.ensemble.clusters),
            searching=self.state.outcome.searching if self.state.outcome else False,
            search_progress=self.state.outcome.search_progress if self.state.outcome else 0.0,
            workers=self.state.placement.workers,
            counters=dict(sorted((Counter(self.state.counters) + Counter(counters)).items())),
            uptime_s=(now_ns - self.started_ns) / 1e9,
            term=self.term.number,
            newest_step=self.state.newest_step,
            settings=self.state.newest_settings,
            overloaded=self.state.overload.is_overloaded,
        )

    def events(self) -> JobEvents:
        """Return the last events of clusters and searches."""
        return self._to_message(tuple(self.state.event_log.kept))

    def _publication(self, now_ns: int) -> list[PublishEvents | PublishBelief]:
        """Return what is published after a step or a command; nothing before the first step.

        Events are published before the belief to which they belong.
        """
        belief = self._belief()
        if belief is None:
            return []
        news = self.state.event_log.news()
        told = [PublishEvents(self._to_message(news))] if news else []
        return [*told, PublishBelief(belief, self.pose(now_ns))]

    def _to_message(self, events: tuple[NumberedEvent, ...]) -> JobEvents:
        return JobEvents(sender=self.sender, events=events, term=self.term.number)

    def _belief(self) -> Belief | None:
        """Return the belief after the last step or command; None before the first."""
        outcome, scan = self.state.outcome, self.state.collector.applied
        if outcome is None or scan is None:
            return None
        return belief_after(scan, outcome, self.sender, self.term.number)
