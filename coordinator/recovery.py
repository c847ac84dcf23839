"""How a coordinator begins: its term, the workers that it asks, the state that it continues from.

Before it begins it decides nothing. Workers that appear later are asked too, if their answers may
matter: a belief that never had clusters is given up for one that had.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from coordinator.belief.given_places import diagonal
from coordinator.belief.prior_pose import PriorPose
from coordinator.checkpoint import state_in
from coordinator.events import WorkerSnapshot
from coordinator.instructions import AskState, FetchScans, Instruction
from coordinator.state import CoordinatorState
from coordinator.step_collector import is_bulky, without_snapshot
from particle_filter.poses import between, compose
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.steps import Scan
from protocol.work import Checkpoint, Report, SearchReport, TakeOver

APART_US = 1_000_000
"""A new term exceeds every known one by at least this much. The epochs of a term's jobs are counted
from the term on, and must not occur again in the next term."""
UNSEEN_NS = 3_000_000_000
"""A leading coordinator publishes its state seven times within this time [ns]."""


class Term:
    """Whether this coordinator leads, and in which term.

    Args:
        number: proposed, from the clock [us].
        known: states of other coordinators, whose terms this one exceeds.
    """

    def __init__(self, number: int, *known: Checkpoint | None) -> None:
        self._number = number
        # Two coordinators that learn of a term at once must not choose the same new one.
        self._own_us = number % APART_US
        self._begun = False
        self._outranked_by: int | None = None
        self._claimed: int | None = None
        self._claimed_ns = 0
        for checkpoint in known:
            if checkpoint is not None:
                self.hear(checkpoint.term)

    @property
    def number(self) -> int:
        return self._number

    @property
    def begun(self) -> bool:
        """Whether this coordinator leads, or has led."""
        return self._begun

    @property
    def outranked_by(self) -> int | None:
        """The term of another coordinator that has deposed this one."""
        return self._outranked_by

    def begin(self) -> None:
        self._begun = True

    def hear(self, number: int) -> bool:
        """Take the term of another coordinator's own message.

        Returns:
            Whether this term was raised above it, which happens only before it begins.
        """
        if self._begun:
            if number > self._number:
                self._outranked_by = max(number, self._outranked_by or 0)
            return False
        if number == self._number or number + APART_US <= self._number:
            return False
        self._raise_above(number)
        return True

    def on_worker_term(self, number: int, now_ns: int) -> bool:
        """Take the highest term that a worker knows, which never deposes."""
        if not self._begun:
            return self.hear(number)
        if number > self._number:
            if self._claimed is None:
                self._claimed_ns = now_ns
            self._claimed = max(number, self._claimed or 0)
        return False

    def rises_above_workers(self, now_ns: int) -> bool:
        """Raise a term whose orders workers refuse, if no coordinator of a higher one appears.

        That one may have died before it led. If it lives, its next message deposes this one.
        """
        if self._claimed is None or now_ns - self._claimed_ns < UNSEEN_NS:
            return False
        claimed, self._claimed = self._claimed, None
        if claimed <= self._number:
            return False
        self._raise_above(claimed)
        return True

    def _raise_above(self, number: int) -> None:
        self._number = (number // APART_US + 2) * APART_US + self._own_us


MOVED_BY_HAND = diagonal(0.5, 0.26)
"""Uncertainty added because the robot may have been pushed meanwhile; as for a given pose."""
ODOMETRY_STARTS_WITHIN = (0.5, 0.5)
"""Odometry this near to its origin [m], [rad] has probably been set to it."""


@dataclass(frozen=True)
class LastPlace:
    """The most probable place when the whole system last ran."""

    map_digest: str
    live: bool
    """Whether it was a robot's, no recording's or simulation's."""
    odom_from_robot: PoseTuple
    map_from_robot: PoseTuple
    covariance: Covariance

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> "LastPlace | None":
        """The most probable place in a checkpoint; None where it has none.

        Raises:
            ValueError: as `state_in`.
        """
        state = state_in(checkpoint)
        applied, clusters = state.collector.applied, state.ensemble.clusters.all()
        if applied is None or not clusters:
            return None
        best = max(clusters, key=lambda cluster: cluster.log_probability)
        return cls(
            map_digest=state.map_digest,
            live=applied.live,
            odom_from_robot=applied.odom_from_robot,
            map_from_robot=best.mean,
            covariance=best.covariance,
        )

    def as_prior_at(self, scan: Scan, probability: float) -> PriorPose:
        """Return the place as it would be at a scan, with the uncertainty of the time between.

        Odometry since then counts, unless it was reset: then the robot stands where it stood.
        """
        pose = np.array(self.map_from_robot)
        if not _starts_anew(self.odom_from_robot, scan.odom_from_robot):
            moved = between(np.array(self.odom_from_robot), np.array(scan.odom_from_robot))
            pose = compose(pose, moved)
        a, b, c, d, e, f, g, h, i = (
            x + y for x, y in zip(self.covariance, MOVED_BY_HAND, strict=True)
        )
        return PriorPose(
            step=scan.step,
            odom_from_robot=scan.odom_from_robot,
            map_from_robot=pose_tuple(pose),
            covariance=(a, b, c, d, e, f, g, h, i),
            probability=probability,
        )


def _starts_anew(before: PoseTuple, now: PoseTuple) -> bool:
    near_m, near_rad = ODOMETRY_STARTS_WITHIN

    def near_origin(pose: PoseTuple) -> bool:
        return math.hypot(pose[0], pose[1]) < near_m and abs(pose[2]) < near_rad

    return near_origin(now) and not near_origin(before)


ASK_AGAIN_NS = 200_000_000
"""A worker whose token is there may not serve the query yet [ns]."""
ORDERS_AFTER_NS = 2_000_000_000
"""A worker that does not answer the question gets orders after this time [ns]."""
MAX_HEARD = 4
"""Most states kept of those that others publish before this coordinator begins."""
KNOWN_NS, UNKNOWN_NS = 500_000_000, 3_000_000_000
"""Longest wait for the last worker, with a state that has places and without one [ns]."""
SILENT_NS = 30_000_000_000
"""Longest wait without one while most workers are silent: busy workers may know the state [ns]."""


def best_first(checkpoints: Iterable[Checkpoint]) -> list[Checkpoint]:
    """Return each state once, the best one to continue from first."""
    once = {(one.rank, one.state): one for one in checkpoints}
    return sorted(once.values(), key=lambda one: one.rank, reverse=True)


class StateRecovery:
    """The workers to ask, their answers, and the states to continue from.

    A state of another coordinator always counts. The state in the file may be of an earlier run of
    the whole system: it counts if a worker knows its term, and none knows a belief of a later one.

    Args:
        sender: of this coordinator.
        known: the newest state that this process received as a follower.
        kept: what the file holds.
        now_ns: by the clock of all events.
    """

    def __init__(
        self, sender: str, known: Checkpoint | None, kept: Checkpoint | None, now_ns: int
    ) -> None:
        self._sender = sender
        self._began_ns = now_ns
        self._asked_ns: dict[str, int | None] = {}
        self._told: dict[str, WorkerSnapshot] = {}
        self._heard = [known] if known else []
        self._kept = kept
        self._is_of_this_life = False
        self._founded = 0
        """The highest term of a belief that a worker has received."""

    @property
    def told(self) -> Mapping[str, WorkerSnapshot]:
        """The answers of the present workers."""
        return self._told

    @property
    def checkpoints(self) -> list[Checkpoint]:
        """The states of other coordinators, the best one to continue from first."""
        kept = [self._kept] if self._kept and self._counts(self._kept) else []
        return best_first([*self._heard, *kept])

    def _counts(self, kept: Checkpoint) -> bool:
        return self._is_of_this_life and self._founded <= kept.term

    def expect(self, worker: str) -> None:
        """Ask a worker that is there."""
        self._asked_ns[worker] = None
        self._told.pop(worker, None)

    def forget(self, worker: str) -> None:
        self._asked_ns.pop(worker, None)
        self._told.pop(worker, None)

    def hear(self, checkpoint: Checkpoint) -> None:
        """Take another coordinator's state."""
        self._heard = best_first([*self._heard, checkpoint])[:MAX_HEARD]

    def answered(self, worker: str, told: WorkerSnapshot) -> None:
        self._asked_ns.pop(worker, None)
        self._told[worker] = told
        self._founded = max(self._founded, told.founded)
        self._is_of_this_life |= self._kept is not None and self._kept.term in told.terms

    def forget_checkpoints(self) -> None:
        """Drop the states: this coordinator has begun, from one of them or from none."""
        self._heard.clear()
        if self._kept and self._counts(self._kept):
            self._kept = None

    def forget_told(self) -> None:
        """Drop everything: this coordinator has a belief of its own."""
        self._told.clear()
        self._kept = None

    def ask_all_again(self) -> None:
        """Ask all workers again, in a higher term."""
        for worker in (*self._asked_ns, *self._told):
            self._asked_ns[worker] = None

    def questions(self, term: int, applied: int, now_ns: int) -> list[AskState]:
        """Return the workers to ask now; `applied` is this coordinator's own last step."""
        due = [
            worker
            for worker, asked_ns in sorted(self._asked_ns.items())
            if asked_ns is None or now_ns - asked_ns >= ASK_AGAIN_NS
        ]
        for worker in due:
            self._asked_ns[worker] = now_ns
        others = [*self._heard, *([self._kept] if self._kept else [])]
        since = min((one.step for one in others), default=applied)
        question = TakeOver(sender=self._sender, term=term, since=since)
        return [AskState(worker, question) for worker in due]

    def is_over(self, now_ns: int) -> bool:
        """Return whether to begin without waiting for more workers.

        To begin without a state may forget all places, which must not happen because workers are
        busy.
        """
        waited_ns = now_ns - self._began_ns
        if any(checkpoint.founded for checkpoint in self.checkpoints):
            wait_ns = KNOWN_NS
        elif len(self._told) >= len(self._asked_ns):
            wait_ns = UNKNOWN_NS
        else:
            wait_ns = SILENT_NS
        return not self._asked_ns or waited_ns >= wait_ns


NEVER_LATER = 16
"""If more steps were lost before the first scan received, they are not requested."""
EARLY_REPORTS, EARLY_BULKY_REPORTS = 10_000, 256
"""Most reports kept before the beginning, and most of them with particles of places."""


class Succession:
    """Decides when this coordinator begins, and from which state.

    Args:
        state: of this coordinator; empty.
        term: of this coordinator; it begins here.
        recovery: asks the workers.
        publication: publishes the belief after a state was restored.
        last_place: where the robot was when the system last ran; None: unknown.
        last_pose_probability: given to it when the first search ends; 0: it is not used.
    """

    def __init__(
        self,
        state: CoordinatorState,
        term: Term,
        recovery: StateRecovery,
        publication: Callable[[int], Sequence[Instruction]],
        last_place: LastPlace | None,
        last_pose_probability: float,
    ) -> None:
        self._state, self._term, self._recovery = state, term, recovery
        self._publication = publication
        self._last_place, self._last_pose_probability = last_place, last_pose_probability
        self._early_reports: list[tuple[Report, str]] = []

    # --- events

    def on_worker_joined(self, worker: str, now_ns: int) -> None:
        """Ask a new worker before it gets orders, unless it can know nothing new."""
        is_missed = self._state.placement.jobs.misses(worker)
        is_asked = is_missed or not (self._term.begun and self._state.founded)
        if is_asked:
            self._recovery.expect(worker)
        self._state.on_worker_joined(worker, now_ns + ORDERS_AFTER_NS if is_asked else 0)

    def on_worker_left(self, worker: str) -> None:
        self._recovery.forget(worker)
        self._state.on_worker_left(worker)

    def on_worker_told(self, worker: str, told: WorkerSnapshot, now_ns: int) -> list[Instruction]:
        """Take a worker's answer: its jobs, its reports, and the terms that it knows."""
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
        """Take another coordinator's state."""
        self._term.hear(checkpoint.term)
        if not self._term.begun:
            self._recovery.hear(checkpoint)

    def on_worker_term(self, number: int, now_ns: int) -> None:
        """Take a worker's highest term; ask all again if this coordinator's was raised."""
        if self._term.on_worker_term(number, now_ns):
            self._recovery.ask_all_again()

    def on_report(self, report: Report, worker: str) -> None:
        """Take a report; before the beginning it is unknown whether it counts."""
        if self._term.begun:
            self._state.on_report(report, worker)
            return
        early = self._early_reports
        bulky = sum(is_bulky(waiting) for waiting, _ in early) if is_bulky(report) else 0
        if len(early) < EARLY_REPORTS and bulky < EARLY_BULKY_REPORTS:
            early.append((without_snapshot(report), worker))
        else:
            self._state.counters["report far ahead, or beside too many"] += 1

    # --- decisions

    def proceed(self, now_ns: int) -> list[Instruction]:
        """Query the workers that are due; begin to lead once waiting for answers is over."""
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
        """Continue from a state, or search for the robot."""
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
        """Begin the first search with this scan, or with those that were lost just before it."""
        if self._state.ensemble.searches:
            return
        before = self._state.collector.before
        lost = 0 if before is None else scan.step - before - 1
        first = scan.step - (lost if lost <= NEVER_LATER else 0)
        self._state.begin_search(first, self._prior_pose(scan))

    def _prior_pose(self, scan: Scan) -> PriorPose | None:
        """Return the last place, if it may be one hypothesis."""
        last, probability = self._last_place, self._last_pose_probability
        if last is None or probability == 0.0 or self._state.commands.forgets:
            return None
        if last.map_digest != scan.map_digest or not self._state.place_counts(last.live):
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
        next_step = self._state.resume(checkpoint, now_ns)
        if next_step is None:
            return []
        for worker, told in self._recovery.told.items():
            self._hear_out(worker, told, now_ns)
        return [FetchScans(next_step, None), *self._publication(now_ns)]

    def _hear_out(self, worker: str, told: WorkerSnapshot, now_ns: int) -> None:
        """Take a worker's jobs, and the reports since the state."""
        self._state.placement.held(worker, told.holds, now_ns)
        applied = self._state.collector.applied
        for report in told.reports:
            if isinstance(report, SearchReport) or applied is None or report.step > applied.step:
                self._state.on_report(report, worker, is_told_late=True)
