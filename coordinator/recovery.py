"""The recovery of the state: the term, the workers to ask, and the states to continue from.

The coordinator decides nothing until recovery ends. It also queries workers that appear later, if
their answers may matter: a belief that never had clusters is replaced by one that had.
"""

import math
from collections.abc import Iterable

import msgspec
import numpy as np

from coordinator.belief.given_places import diagonal
from coordinator.belief.prior_pose import PriorPose
from coordinator.checkpoint import state_in
from coordinator.events import WorkerSnapshot
from coordinator.instructions import AskState
from coordinator.part import Part
from particle_filter.poses import between, compose
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.steps import Scan
from protocol.work import Checkpoint, TakeOver

APART_US = 1_000_000
"""A new term exceeds every known one by at least this much. The epochs of a term's jobs are counted
from the term on, and must not occur again in the next term."""
UNSEEN_NS = 3_000_000_000
"""A leading coordinator publishes its state seven times within this time [ns]."""


class Term(Part):
    """The number by which coordinators are ranked, and whether this one leads."""

    number: int
    """From the clock [us]; above all terms that were known before it began."""
    own_us: int
    """Last digits of the number: two coordinators that learn of a term at once must not choose the
    same new one."""
    begun: bool = False
    """Whether this coordinator leads, or has led."""
    outranked_by: int | None = None
    """The term of another coordinator that has deposed this one."""
    claimed: int | None = None
    """A higher term that a worker knows."""
    claimed_ns: int = 0

    @classmethod
    def of(cls, number: int, *known: Checkpoint | None) -> "Term":
        """Return a term above those of known states.

        Args:
            number: proposed, from the clock [us].
            known: states of other coordinators.
        """
        term = cls(number, number % APART_US)
        for checkpoint in filter(None, known):
            term.hear(checkpoint.term)
        return term

    def hear(self, number: int) -> bool:
        """Process the term in a message of another coordinator.

        Returns:
            Whether this term was raised above it, which happens only before it begins.
        """
        if self.begun:
            if number > self.number:
                self.outranked_by = max(number, self.outranked_by or 0)
            return False
        if number == self.number or number + APART_US <= self.number:
            return False
        self._raise_above(number)
        return True

    def on_worker_term(self, number: int, now_ns: int) -> bool:
        """Take the highest term that a worker knows, which never deposes."""
        if not self.begun:
            return self.hear(number)
        if number > self.number:
            if self.claimed is None:
                self.claimed_ns = now_ns
            self.claimed = max(number, self.claimed or 0)
        return False

    def rises_above_workers(self, now_ns: int) -> bool:
        """Raise this term above one that a worker knows, if its coordinator does not appear.

        That coordinator may have died before it led. If it is alive, its next message deposes this
        one.

        Returns:
            Whether the term was raised.
        """
        if self.claimed is None or now_ns - self.claimed_ns < UNSEEN_NS:
            return False
        claimed, self.claimed = self.claimed, None
        if claimed <= self.number:
            return False
        self._raise_above(claimed)
        return True

    def _raise_above(self, number: int) -> None:
        self.number = (number // APART_US + 2) * APART_US + self.own_us


MOVED_BY_HAND = diagonal(0.5, 0.26)
"""Uncertainty added because the robot may have been pushed meanwhile; as for a given pose."""
ODOMETRY_STARTS_WITHIN = (0.5, 0.5)
"""Odometry this near to its origin [m], [rad] has probably been set to it."""


class LastPlace(msgspec.Struct, frozen=True):
    """The most probable place when the whole system last ran."""

    map_digest: str
    live: bool
    """Whether the scans were those of a robot, not of a recording or a simulation."""
    odom_from_robot: PoseTuple
    map_from_robot: PoseTuple
    covariance: Covariance

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> "LastPlace | None":
        """Return the most probable place in a checkpoint; None: it has no place.

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


class StateRecovery(Part):
    """The workers to ask, their answers, and the states to continue from.

    A state of another coordinator always counts. The state in the file may be of an earlier run of
    the whole system: it counts if a worker knows its term, and none knows a belief of a later one.
    """

    sender: str
    began_ns: int
    """When this coordinator began to ask, by the clock of all events."""
    received: list[Checkpoint]
    """The best states of other coordinators."""
    kept: Checkpoint | None = None
    """State from the file; None: there is none."""
    asked_ns: dict[str, int | None] = {}
    """When the workers that have not answered were asked; None: not yet."""
    told: dict[str, WorkerSnapshot] = {}
    """The answers of the connected workers, by name."""
    is_of_this_life: bool = False
    """Whether a worker knows the term of the kept state."""
    founded: int = 0
    """The highest term of a belief that a worker has received."""

    @property
    def checkpoints(self) -> list[Checkpoint]:
        """The states of other coordinators, the best one to continue from first."""
        kept = [self.kept] if self.kept and self._counts(self.kept) else []
        return best_first([*self.received, *kept])

    def _counts(self, kept: Checkpoint) -> bool:
        return self.is_of_this_life and self.founded <= kept.term

    def expect(self, worker: str) -> None:
        """Ask a worker that is there."""
        self.asked_ns[worker] = None
        self.told.pop(worker, None)

    def forget(self, worker: str) -> None:
        self.asked_ns.pop(worker, None)
        self.told.pop(worker, None)

    def hear(self, checkpoint: Checkpoint) -> None:
        """Take another coordinator's state."""
        self.received = best_first([*self.received, checkpoint])[:MAX_HEARD]

    def answered(self, worker: str, told: WorkerSnapshot) -> None:
        self.asked_ns.pop(worker, None)
        self.told[worker] = told
        self.founded = max(self.founded, told.founded)
        self.is_of_this_life |= self.kept is not None and self.kept.term in told.terms

    def forget_checkpoints(self) -> None:
        """Drop the states of other coordinators; they are not needed after the start."""
        self.received.clear()
        if self.kept and self._counts(self.kept):
            self.kept = None

    def forget_told(self) -> None:
        """Drop all received states: this coordinator has its own belief now."""
        self.told.clear()
        self.kept = None

    def ask_all_again(self) -> None:
        """Ask all workers again, in a higher term."""
        for worker in (*self.asked_ns, *self.told):
            self.asked_ns[worker] = None

    def questions(self, term: int, applied: int, now_ns: int) -> list[AskState]:
        """Return the workers to ask now; `applied` is this coordinator's own last step."""
        due = [
            worker
            for worker, asked_ns in sorted(self.asked_ns.items())
            if asked_ns is None or now_ns - asked_ns >= ASK_AGAIN_NS
        ]
        for worker in due:
            self.asked_ns[worker] = now_ns
        others = [*self.received, *([self.kept] if self.kept else [])]
        since = min((one.step for one in others), default=applied)
        question = TakeOver(sender=self.sender, term=term, since=since)
        return [AskState(worker, question) for worker in due]

    def is_over(self, now_ns: int) -> bool:
        """Return whether to begin without waiting for more workers.

        To begin without a state may forget all places, which must not happen because workers are
        busy.
        """
        waited_ns = now_ns - self.began_ns
        if any(checkpoint.founded for checkpoint in self.checkpoints):
            wait_ns = KNOWN_NS
        elif len(self.told) >= len(self.asked_ns):
            wait_ns = UNKNOWN_NS
        else:
            wait_ns = SILENT_NS
        return not self.asked_ns or waited_ns >= wait_ns
