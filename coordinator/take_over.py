"""How a coordinator begins: it asks the workers what another had decided, and carries on from it.

Before it begins it decides nothing. Workers that appear later are asked too, where what they know
may matter: a belief that has never had clusters is given up for one that has.
"""

from collections.abc import Iterable

from coordinator.answers import Answers
from coordinator.belief.prior_pose import PriorPose
from coordinator.failover.state_recovery import ORDERS_AFTER_NS, StateRecovery, Told
from coordinator.failover.term import Term
from coordinator.instructions import FetchScans, Instruction
from coordinator.last_place import LastPlace
from coordinator.state import CoordinatorState
from coordinator.step_collector import is_bulky, without_snapshot
from protocol.steps import Scan
from protocol.work import Checkpoint, Report, SearchReport

NEVER_LATER = 16
"""More steps than this lost before the first scan that is heard, and nobody looks for them."""
EARLY_REPORTS, EARLY_BULKY_REPORTS = 10_000, 256
"""Reports that are kept before the beginning, and those of them with particles of places."""


class TakeOver:
    """Decides when this coordinator begins, and from what.

    Args:
        state: of this coordinator; empty so far.
        term: of this coordinator; it begins here.
        recovery: whom to ask.
        answers: tell what is believed after another's state was taken over.
        last_place: where the robot was at the end of an earlier life; None: nobody knows.
        last_pose_probability: given to it when the first search ends; 0: it is not used.
    """

    def __init__(
        self,
        state: CoordinatorState,
        term: Term,
        recovery: StateRecovery,
        answers: Answers,
        last_place: LastPlace | None,
        last_pose_probability: float,
    ) -> None:
        self._state, self._term, self._recovery, self._answers = state, term, recovery, answers
        self._last_place, self._last_pose_probability = last_place, last_pose_probability
        self._early_reports: list[tuple[Report, str]] = []

    # --- what is heard

    def on_worker_joined(self, worker: str, now_ns: int) -> None:
        """A worker is there; it is asked before it gets orders, unless it can know nothing new."""
        is_missed = self._state.placement.jobs.misses(worker)
        is_asked = is_missed or not (self._term.begun and self._state.founded)
        if is_asked:
            self._recovery.expect(worker)
        self._state.on_worker_joined(worker, now_ns + ORDERS_AFTER_NS if is_asked else 0)

    def on_worker_left(self, worker: str) -> None:
        """A worker is gone."""
        self._recovery.forget(worker)
        self._state.on_worker_left(worker)

    def on_worker_told(self, worker: str, told: Told, now_ns: int) -> list[Instruction]:
        """A worker says what it does, and what the last coordinator had decided."""
        self.on_worker_term(told.term, now_ns)
        if told.term <= self._term.number:
            self._recovery.answered(worker, told)
        if not self._term.begun:
            return []
        resumed = list[Instruction]()
        if not self._state.founded:
            founded = [one for one in self._recovery.checkpoints if one.founded]
            resumed = self._resume_best(founded, now_ns)
        self._recovery.forget_checkpoints()
        if not resumed:
            self._hear_out(worker, told, now_ns)
        return resumed

    def on_checkpoint(self, checkpoint: Checkpoint) -> None:
        """Another coordinator published its checkpoint."""
        self._term.hear(checkpoint.term)
        if not self._term.begun:
            self._recovery.hear(checkpoint)

    def on_worker_term(self, number: int, now_ns: int) -> None:
        """A worker knows a term; all are asked again if this coordinator's had to be raised."""
        if self._term.on_worker_term(number, now_ns):
            self._recovery.ask_all_again()

    def on_report(self, report: Report, worker: str) -> None:
        """A worker's job took a step; before the beginning nobody knows whether it counts."""
        if self._term.begun:
            self._state.on_report(report, worker)
            return
        early = self._early_reports
        bulky = sum(is_bulky(waiting) for waiting, _ in early) if is_bulky(report) else 0
        if len(early) < EARLY_REPORTS and bulky < EARLY_BULKY_REPORTS:
            early.append((without_snapshot(report), worker))
        else:
            self._state.counters["report far ahead, or beside too many"] += 1

    # --- what is done

    def proceed(self, now_ns: int) -> list[Instruction]:
        """Ask whom there is to ask, and begin when nobody is waited for any longer."""
        applied = self._state.collector.applied
        own_step = applied.step if applied else -1
        questions = self._recovery.questions(self._term.number, own_step, now_ns)
        instructions = list[Instruction](questions)
        if self._term.begun and self._term.rises_above_workers(now_ns):
            self._state.counters["term raised above a worker's"] += 1
            self._state.publish_again()
        if not self._term.begun and self._recovery.is_over(now_ns):
            instructions += self._begin(now_ns)
        if self._term.begun and self._state.founded:
            self._recovery.forget_told()
        return instructions

    def _begin(self, now_ns: int) -> list[Instruction]:
        """All has been heard: carry on from another's state, or begin anew."""
        self._term.begin()
        instructions = self._resume_best(self._recovery.checkpoints, now_ns)
        self._recovery.forget_checkpoints()
        if not instructions:
            for worker in self._recovery.told:
                self._state.placement.held(worker, (), now_ns)
            waiting = self._state.collector.oldest_scan
            if waiting is not None:
                self.begin_search(waiting)
            else:
                instructions.append(FetchScans(0, None))
        for report, worker in self._early_reports:
            self._state.on_report(report, worker)
        self._early_reports.clear()
        return instructions

    def begin_search(self, scan: Scan) -> None:
        """The first search begins with this scan, or those that were lost just before it."""
        if self._state.ensemble.searches:
            return
        before = self._state.collector.before
        lost = 0 if before is None else scan.step - before - 1
        first = scan.step - (lost if lost <= NEVER_LATER else 0)
        self._state.begin_search(first, self._prior_pose(scan))

    def _prior_pose(self, scan: Scan) -> PriorPose | None:
        """Where the robot was at the end of an earlier life, as one place that is possible."""
        last, probability = self._last_place, self._last_pose_probability
        if last is None or probability == 0.0 or self._state.commands.forgets:
            return None
        if last.map_digest != scan.map_digest or not self._state.place_counts(last.live):
            return None
        return last.as_prior_at(scan, probability)

    def _resume_best(self, checkpoints: Iterable[Checkpoint], now_ns: int) -> list[Instruction]:
        """Carry on from the first of them that can be used; nothing is done if none can."""
        resumed = (self._resume(checkpoint, now_ns) for checkpoint in checkpoints)
        return next(filter(None, resumed), [])

    def _resume(self, checkpoint: Checkpoint, now_ns: int) -> list[Instruction]:
        """Carry on from another's state; nothing is done if it cannot be used.

        The belief that was last is published again: the one before may not have come to it.
        """
        next_step = self._state.resume(checkpoint, now_ns)
        if next_step is None:
            return []
        for worker, told in self._recovery.told.items():
            self._hear_out(worker, told, now_ns)
        return [FetchScans(next_step, None), *self._answers.publication(now_ns)]

    def _hear_out(self, worker: str, told: Told, now_ns: int) -> None:
        """Take what a worker holds, and what it has reported while nobody was there."""
        self._state.placement.held(worker, told.holds, now_ns)
        applied = self._state.collector.applied
        for report in told.reports:
            if isinstance(report, SearchReport) or applied is None or report.step > applied.step:
                self._state.on_report(report, worker, is_told_late=True)
