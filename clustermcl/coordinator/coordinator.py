"""The coordinator's decisions: events and the time in, instructions out.

No network and no clock, so a unit test can replay any failure of a worker or a network.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import assert_never

import msgspec
from msgspec import field
from msgspec.structs import replace

from clustermcl.belief.outcome import belief_after
from clustermcl.belief.part import Part
from clustermcl.coordinator import events
from clustermcl.coordinator import instructions as do
from clustermcl.coordinator.checkpoint import state_in, to_bytes
from clustermcl.coordinator.recovery import ORDERS_AFTER_NS, LastPlace, StateRecovery, Term
from clustermcl.coordinator.state import CoordinatorState
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.advice import Advice, AdviceQuestion, advice_question
from clustermcl.protocol.answers import (
    Belief,
    CommandDone,
    Hypotheses,
    PoseAnswer,
    Relocalize,
    SetPose,
    Status,
)
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.job_events import JobEvents, NumberedEvent
from clustermcl.protocol.step_reset_detector import StepResetDetector, is_huge_jump
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Checkpoint, Place, WorkerState
from clustermcl.runtime.settings import BridgeSettings, CoordinatorSettings

SIGN_OF_LIFE_NS = 400_000_000
"""An unchanged state is published again after this time [ns]."""
STEPS_AT_ONCE = 4
"""Largest number of steps applied at an event, so that orders and answers are sent in between."""
MAX_LOST_BEFORE_FIRST = 16
"""If more steps were lost before the first received scan, the search begins without them."""


class Started(msgspec.Struct, frozen=True, kw_only=True):
    """The arguments with which a coordinator is made."""

    sender: str
    filter_settings: FilterSettings
    settings: CoordinatorSettings
    bridge: BridgeSettings = BridgeSettings()
    """The gate in these settings defines a step."""
    version: str
    now_ns: int
    term: int = 0
    """From the clock [us]; raised above all terms that workers have received."""
    known: Checkpoint | None = None
    """The newest state received from another coordinator."""
    kept: Checkpoint | None = None
    """A state from the file of this machine, which `state_in` accepts."""

    def coordinator(self) -> "Coordinator":
        kept = state_in(self.kept) if self.kept else None
        kept_scan = kept.collector.applied if kept else None
        known = [self.known] if self.known else []
        made = Coordinator(
            self.sender,
            self.version,
            self.now_ns,
            Term(self.term),
            StateRecovery(self.sender, self.now_ns, known, self.kept, kept_scan),
            CoordinatorState.of(self.sender, self.filter_settings, self.settings, self.bridge),
            LastPlace.of(kept) if kept else None,
        )
        for checkpoint in filter(None, (self.known, self.kept)):
            made.term.on_term(checkpoint.term)
        return made


class Coordinator(Part):
    """A coordinator that recovers or leads; `Replica` follows before that."""

    sender: str
    version: str
    started_ns: int
    term: Term
    recovery: StateRecovery
    state: CoordinatorState
    last_place: LastPlace | None = None
    published: Checkpoint | None = None
    published_ns: int = 0
    step_resets: StepResetDetector = field(default_factory=StepResetDetector)
    linked: bool = True

    def handle(  # noqa: PLR0911, PLR0912 - a branch for each event
        self, event: events.Event, now_ns: int
    ) -> list[do.Instruction]:
        """Process an event; return instructions to carry out in this order."""
        match event:
            case events.ScanArrived(scan):
                return self._on_scan(scan, now_ns)
            case events.HistoryArrived(scans):
                return self._on_history(scans, now_ns)
            case events.WorkerStateArrived(worker, snapshot):
                return self._on_worker_state(worker, snapshot, now_ns)
            case events.CommandArrived(command):
                return self._on_command(command, now_ns)
            case events.MapArrived(ground):
                published = self._publication(now_ns) if self.state.on_map_arrived(ground) else []
                return [*published, *self._on_time_passed(now_ns)]
            case events.OdometryArrived(reading):
                self.state.pose.odometry(reading.stamp_ns, reading.odom_from_robot, now_ns)
                return []
            case events.OrderAnswered(worker, answer):
                if answer.problem:
                    self.state.count(Cause.ORDER_REFUSED)  # the worker's log contains the reason
                self._on_worker_term(answer.term, now_ns)
                self.state.placement.on_order_answer(worker, answer)
                return []
            case events.CheckpointArrived(checkpoint):
                self.term.on_term(checkpoint.term)
                if not self.term.begun:
                    self.recovery.on_checkpoint(checkpoint)
                return []
            case events.ReportArrived(worker, report):
                # During recovery it is unknown which reports count; the first orders repeat them.
                if self.term.begun:
                    self.state.on_report(report, worker, now_ns)
                    # Nine in ten reports complete no step; the next event does what became due.
                    if self.state.awaits_reports:
                        return []
            case events.WorkerChanged(worker, "joined"):
                self._on_worker_joined(worker, now_ns)
            case events.WorkerChanged(worker, "left"):
                self.recovery.forget(worker)
                self.state.placement.on_worker_left(worker)
                self.state.changed = True
            case events.WorkerChanged(worker):
                self.state.placement.repeat_order(worker)
            case events.LinkChanged(up):
                self.linked = up
                if up:
                    self.state.collector.restart_deadlines(now_ns)
                    self.state.placement.on_link_back()
            case events.TimePassed():
                pass
            case _:
                assert_never(event)
        return self._on_time_passed(now_ns)

    # --- scans

    def _on_scan(self, scan: Scan, now_ns: int, *, fetched: bool = False) -> list[do.Instruction]:
        state = self.state
        if not state.on_map(scan):
            return []
        newest = state.collector.newest_scan or state.collector.applied
        if is_huge_jump(scan, newest):
            state.count(Cause.SCAN_AHEAD)
            return self._on_stray_scan(scan, newest, now_ns, fetched=fetched)
        if not state.collector.on_scan(scan, now_ns):
            state.count(Cause.SCAN_LATE)
            return self._on_stray_scan(scan, state.collector.applied, now_ns, fetched=fetched)
        self.step_resets.reset()
        state.pose.scan(scan, now_ns, fetched=fetched)
        if not self.term.begun:
            return self._on_time_passed(now_ns)
        self._begin_search(scan)
        lost = state.collector.lost_before(scan)
        return ([self._fetch(*lost)] if lost else []) + self._on_time_passed(now_ns)

    def _on_stray_scan(
        self, scan: Scan, newest: Scan | None, now_ns: int, *, fetched: bool
    ) -> list[do.Instruction]:
        """Process a scan whose step does not follow the step of `newest`."""
        if self.term.begun and not fetched and self.step_resets.on_other_scan(scan, newest):
            self.step_resets.reset()
            self.state.count(Cause.STEPS_RESTARTED)
            self.state.search_again(scan, "steps restarted")
            return self._on_scan(scan, now_ns)
        # The bridge may have missed the belief.
        is_repeated = scan.lockstep and scan.step == self.state.applied_step
        return [*self._publication(now_ns)] if is_repeated else []

    def _fetch(self, first: int, last: int | None) -> do.FetchScans:
        self.state.collector.is_fetching = True
        return do.FetchScans(first, last)

    def _on_history(self, scans: Sequence[Scan], now_ns: int) -> list[do.Instruction]:
        """Process fetched scans; a coordinator without a search begins with the newest one."""
        self.state.collector.is_fetching = False
        self.recovery.on_history(scans)
        resumed = self._resume_late(now_ns) if self.term.begun else []
        if resumed or not self.term.begun:
            return resumed + self._on_time_passed(now_ns)
        if not self.state.ensemble.searches:
            self.state.collector.begin_after(scans[-1].step - 1 if scans else -1)
            scans = scans[-1:]
        return [one for scan in scans for one in self._on_scan(scan, now_ns, fetched=True)]

    # --- workers

    def _on_worker_joined(self, worker: str, now_ns: int) -> None:
        """Query a new worker for its state before it gets orders, if the state may matter."""
        placement = self.state.placement
        is_awaited = worker in placement.jobs.awaited_until_ns
        is_asked = is_awaited or not (self.term.begun and self.state.founded)
        if is_asked:
            self.recovery.expect(worker)
        placement.on_worker_joined(worker, now_ns + ORDERS_AFTER_NS if is_asked else 0)
        self.state.changed = True

    def _on_worker_state(
        self, worker: str, answer: WorkerState, now_ns: int
    ) -> list[do.Instruction]:
        if worker not in self.state.placement.live:
            return []
        self._on_worker_term(answer.term, now_ns)
        if answer.term <= self.term.number:
            self.recovery.on_answer(worker, answer)
        if not self.term.begun:
            return self._on_time_passed(now_ns)
        resumed = self._resume_late(now_ns)
        self.recovery.drop_checkpoints()
        if not resumed:
            self.state.placement.on_worker_jobs(worker, answer.holds, now_ns)
        return resumed + self._on_time_passed(now_ns)

    def _on_worker_term(self, number: int, now_ns: int) -> None:
        if self.term.on_worker_term(number, now_ns):
            self.recovery.ask_all_again()

    # --- commands and time

    def _on_command(self, command: SetPose | Relocalize, now_ns: int) -> list[do.Instruction]:
        """Carry out a command once for each id; its effects are published before the answer."""
        instructions: list[do.Instruction] = []
        if command.command_id not in self.state.commands.problems:
            if self.state.carry_out(command):
                instructions += self._publication(now_ns)
            instructions += self._on_time_passed(now_ns)
        problem = self.state.commands.problems.get(command.command_id, "")
        return [*instructions, CommandDone(sender=self.sender, problem=problem)]

    def _on_time_passed(self, now_ns: int) -> list[do.Instruction]:
        """Apply the steps that are due, and send workers their orders.

        A changed state is published before the orders and beliefs that follow from it.
        """
        state = self.state
        if not self.linked or self.term.outranked_by is not None:
            return []
        instructions = self._proceed(now_ns)
        if not self.term.begun:
            return instructions
        for _ in range(STEPS_AT_ONCE):
            if (ready := state.ready(now_ns)) is None:
                break
            state.apply(ready, now_ns)
            instructions += self._publication(now_ns)
        orders = state.placement.orders(
            term=self.term.number,
            map_digest=state.map_digest,
            now_ns=now_ns,
            newest_step=state.newest_step,
            applied_step=state.applied_step,
        )
        if state.wants_map(now_ns):
            instructions.append(do.FetchMap())
        first = self._checkpoint(now_ns, is_new=state.changed or bool(orders))
        return [*first, *(do.SendOrder(worker, order) for worker, order in orders), *instructions]

    def _checkpoint(self, now_ns: int, *, is_new: bool) -> list[Checkpoint]:
        """Return a new state, or the last one if a sign of life is due."""
        last = self.published
        if is_new:
            last = Checkpoint(
                sender=self.sender,
                term=self.term.number,
                serial=last.serial + 1 if last else 0,
                step=self.state.applied_step,
                founded=self.state.founded,
                state=to_bytes(self.state.hand_on(now_ns)),
            )
        elif last is None or now_ns - self.published_ns < SIGN_OF_LIFE_NS:
            return []
        self.published, self.published_ns = last, now_ns
        return [last]

    # --- recovery

    def _proceed(self, now_ns: int) -> list[do.Instruction]:
        """Query workers, raise the term, and begin to lead, each when due."""
        instructions = list[do.Instruction](self.recovery.questions(self.term.number, now_ns))
        if self.term.begun and self.term.rises_above_workers(now_ns):
            self.state.count(Cause.TERM_RAISED)
            self.state.changed = True  # the term is a part of what is published
        if not self.term.begun and self.recovery.is_over(now_ns):
            instructions += self._begin(now_ns)
        if self.term.begun and self.state.founded:
            self.recovery.answers.clear()
            self.recovery.kept = self.recovery.kept_scan = None
        return instructions

    def _begin(self, now_ns: int) -> list[do.Instruction]:
        self.term.begun = True
        instructions = self._resume(self.recovery.checkpoints, now_ns)
        self.recovery.drop_checkpoints()
        if not instructions:
            for worker in self.recovery.answers:
                self.state.placement.on_worker_jobs(worker, (), now_ns)
            if waiting := self.state.collector.oldest_scan:
                self._begin_search(waiting)
            else:
                instructions.append(self._fetch(0, None))
        self.state.collector.restart_deadlines(now_ns)
        return instructions

    def _begin_search(self, scan: Scan) -> None:
        """Begin the first search with this scan, or with scans that were lost just before it."""
        state, before = self.state, self.state.collector.before
        if state.ensemble.searches:
            return
        lost = 0 if before is None else scan.step - before - 1
        first = scan.step - (lost if lost <= MAX_LOST_BEFORE_FIRST else 0)
        state.collector.begin_after(first - 1)
        state.placement.jobs.begin(state.ensemble.begin_at(first, self._prior_pose(scan)))
        state.changed = True

    def _prior_pose(self, scan: Scan) -> Place | None:
        """Return the robot's last pose, if it can be a hypothesis at this scan."""
        last, settings = self.last_place, self.state.settings
        if last is None or settings.last_pose_probability == 0.0 or self.state.commands.forgets:
            return None
        # For a recording or a simulation, it counts only in a folder that the settings name.
        is_live = last.live and self.state.pose.live
        if last.map_digest != scan.map_digest or not (is_live or settings.state_folder):
            return None
        seed = self.state.filter_settings.seed
        return last.as_prior_at(scan, settings.last_pose_probability, seed)

    def _resume_late(self, now_ns: int) -> list[do.Instruction]:
        """Continue from a state that counts since the coordinator leads, if it has no place yet."""
        if self.state.founded:
            return []
        founded = [one for one in self.recovery.checkpoints if one.founded]
        return self._resume(founded, now_ns)

    def _resume(self, checkpoints: Iterable[Checkpoint], now_ns: int) -> list[do.Instruction]:
        """Continue from the first usable state; return no instruction if there is none."""
        for checkpoint in checkpoints:
            next_step = self.state.resume(checkpoint, now_ns)
            if next_step is not None:
                for worker, answer in self.recovery.answers.items():
                    self.state.placement.on_worker_jobs(worker, answer.holds, now_ns)
                # The other coordinator may have died before it published its last belief.
                return [self._fetch(next_step, None), *self._publication(now_ns)]
        return []

    # --- answers

    def pose(self, now_ns: int) -> PoseAnswer:
        answer = self.state.pose.answer(now_ns, len(self.state.placement.live))
        answer = self._floors.answered(answer, self.state.pose.outcome.hypotheses)
        return replace(answer, term=self.term.number)

    def hypotheses(self, now_ns: int) -> Hypotheses:
        places = tuple(map(self._floors.place, self.state.pose.hypotheses()))
        pose, why = self.pose(now_ns), self.state.pose.outcome.why
        return Hypotheses(sender=self.sender, pose=pose, hypotheses=places, why=why)

    @property
    def _floors(self) -> Floors:
        applied = self.state.collector.applied
        return applied.floors if applied else ONE_MAP

    def status(self, now_ns: int, counters: dict[str, int]) -> Status:
        """Return the status; `counters` are those of the process."""
        pose, ground = self.pose(now_ns), self.state.ground
        newest = self.state.collector.newest_scan
        return Status(
            sender=self.sender,
            version=self.version,
            state=pose.state,
            freshness=pose.freshness,
            age_s=pose.age_s,
            scan_age_s=pose.scan_age_s,
            floors=pose.floors,
            step=pose.step,
            steps_applied=self.state.steps_applied,
            steps_lost=self.state.collector.steps_lost,
            reports_missing=self.state.reports_missing,
            map_digest=self.state.map_digest or (ground.map_digest if ground else ""),
            clusters=len(self.state.ensemble.clusters),
            searching=self.state.pose.outcome.searching,
            search_progress=self.state.pose.outcome.search_progress,
            workers=self.state.placement.workers,
            counters=dict(sorted((Counter(self.state.counters) + Counter(counters)).items())),
            uptime_s=(now_ns - self.started_ns) / 1e9,
            term=self.term.number,
            newest_step=self.state.newest_step,
            settings=newest.settings if newest else self.state.live,
            overloaded=self.state.overload.is_overloaded,
        )

    def advice_question(self, radius_m: float) -> tuple[list[str], AdviceQuestion] | Advice:
        """Return the workers to ask, the best first, and the question; or the known advice."""
        outcome, scan = self.state.pose.outcome, self.state.collector.applied
        jobs = {name: jobs for name, jobs in self.state.placement.workers.items() if jobs}
        if scan is None or not jobs:
            problem = "there is no belief yet" if jobs else "no worker has a job"
            return Advice(sender=self.sender, note=problem)
        bridge = self.state.bridge
        question = advice_question(
            outcome.hypotheses,
            outcome.elsewhere_probability,
            scan,
            self.state.ensemble.seen.views,
            (bridge.gate_distance_m, bridge.gate_turn_rad),
            radius_m=radius_m,
            sender=self.sender,
        )
        reports = self.state.placement.stragglers.waits_for
        return sorted(jobs, key=lambda name: (not reports(name), len(jobs[name]))), question

    def events(self) -> JobEvents:
        return self._to_message(tuple(self.state.event_log.kept))

    def _publication(self, now_ns: int) -> list[JobEvents | Belief | PoseAnswer]:
        """Return what is published after a step or a command; nothing before the first step."""
        scan = self.state.collector.applied
        if scan is None:
            return []
        belief = belief_after(scan, self.state.pose.outcome, self.sender, self.term.number)
        news = self.state.event_log.news()
        first = [self._to_message(news)] if news else []
        return [*first, belief, self.pose(now_ns)]

    def _to_message(self, events: tuple[NumberedEvent, ...]) -> JobEvents:
        return JobEvents(sender=self.sender, events=events, term=self.term.number)
