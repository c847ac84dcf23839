"""The recovery of the state: the term, the workers to ask, and the states to continue from.

The coordinator decides nothing until recovery ends. It also queries workers that appear later if
their answers may matter: a state that had clusters replaces a belief that never had any.
"""

import math
from collections.abc import Iterable

import msgspec

from clustermcl.belief.given_places import candidate, diagonal, moved_pose
from clustermcl.belief.part import Part
from clustermcl.coordinator.checkpoint import CheckpointState
from clustermcl.coordinator.instructions import AskState, FetchScans
from clustermcl.filter.random_streams import Purpose
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.protocol.pose_arrays import covariance_matrix, covariance_tuple
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Checkpoint, Place, TakeOver, WorkerState

APART_US = 1_000_000
"""A new term exceeds every known term by at least this much: the epochs of a term's jobs follow the
term's number, and must not occur again in the next term."""
UNSEEN_NS = 3_000_000_000
"""A leading coordinator publishes its state seven times within this time [ns]."""


class Term(Part):
    """The number by which coordinators are ranked, and whether this one leads."""

    number: int
    """From the clock [us]; above all terms that were known before the coordinator began."""
    begun: bool = False
    """Whether this coordinator leads, or has led."""
    outranked_by: int | None = None
    """The term of another coordinator that has deposed this one."""
    claimed: int | None = None
    """A higher term that a worker has received, first at `claimed_ns`."""
    claimed_ns: int = 0

    def on_term(self, number: int) -> bool:
        """Process another coordinator's term; return whether this one's was raised.

        It is raised only before this coordinator begins. Later, a higher term deposes it.
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
        """Process a worker's term, which never deposes; return whether this one's was raised."""
        if not self.begun:
            return self.on_term(number)
        if number > self.number:
            if self.claimed is None:
                self.claimed_ns = now_ns
            self.claimed = max(number, self.claimed or 0)
        return False

    def rises_above_workers(self, now_ns: int) -> bool:
        """Raise the term if a worker's coordinator has not appeared; return whether it was raised.

        The other coordinator may have died before it led. If it is alive, its next message deposes
        this coordinator.
        """
        if self.claimed is None or now_ns - self.claimed_ns < UNSEEN_NS:
            return False
        claimed, self.claimed = self.claimed, None
        if claimed <= self.number:
            return False
        self._raise_above(claimed)
        return True

    def _raise_above(self, number: int) -> None:
        # The last digits stay: two coordinators that receive one term must not choose the same.
        self.number = (number // APART_US + 2) * APART_US + self.number % APART_US


MOVED_BY_HAND = diagonal(0.5, 0.26)
"""Covariance added because the robot may have been pushed meanwhile; as for a given pose."""
ODOMETRY_STARTS_WITHIN = (0.5, 0.5)
"""Odometry within this distance [m] and turn [rad] of its origin was probably reset."""


class LastPlace(msgspec.Struct, frozen=True):
    """The robot's most probable pose when the whole system last ran."""

    map_digest: str
    live: bool
    odom_from_robot: PoseTuple
    pose: PoseTuple
    covariance: Covariance

    @classmethod
    def of(cls, state: CheckpointState) -> "LastPlace | None":
        """Return the most probable pose in a state; None: the state has no cluster."""
        applied, clusters = state.collector.applied, state.ensemble.clusters.all()
        if applied is None or not clusters:
            return None
        best = max(clusters, key=lambda cluster: cluster.log_probability)
        return cls(
            map_digest=state.map_digest,
            live=applied.live,
            odom_from_robot=applied.odom_from_robot,
            pose=best.pose,
            covariance=best.covariance,
        )

    def as_prior_at(self, scan: Scan, probability: float, seed: int) -> Place:
        """Return the pose at a scan, with more uncertainty because the robot may have been moved.

        The motion by odometry is added, unless the odometry was reset: then it probably stood.
        """
        before, now = self.odom_from_robot, scan.odom_from_robot
        was_reset = _is_near_origin(now) and not _is_near_origin(before)
        spread = covariance_matrix(self.covariance) + covariance_matrix(MOVED_BY_HAND)
        return candidate(
            probability,
            self.pose if was_reset else moved_pose(self.pose, before, now),
            covariance_tuple(spread),
            seed=seed,
            purpose=Purpose.LAST_POSE,
            entity=0,
            step=scan.step,
            odom_from_robot=now,
        )


def _is_near_origin(pose: PoseTuple) -> bool:
    near_m, near_rad = ODOMETRY_STARTS_WITHIN
    return math.hypot(pose[0], pose[1]) < near_m and abs(pose[2]) < near_rad


ASK_AGAIN_NS = 200_000_000
"""A query is repeated after this time: a new worker may not serve it yet [ns]."""
ORDERS_AFTER_NS = 2_000_000_000
"""A worker that does not answer the query gets orders after this time [ns]."""
MAX_RECEIVED = 4
"""Largest number of states kept from other coordinators."""
KNOWN_NS, UNKNOWN_NS = 500_000_000, 3_000_000_000
"""Longest wait for the last worker, with a founded state and without one [ns]."""
SILENT_NS = 30_000_000_000
"""Longest wait without a founded state while most workers are silent: busy workers may know one
[ns]."""


def best_first(checkpoints: Iterable[Checkpoint]) -> list[Checkpoint]:
    """Return each state once, in descending order of rank."""
    once = {(one.rank, one.state): one for one in checkpoints}
    return sorted(once.values(), key=lambda one: one.rank, reverse=True)


class StateRecovery(Part):
    """The workers to ask, their answers, and the states to continue from.

    A state of another coordinator always counts. The state in the file may come from an earlier run
    of the whole system. It counts if a worker has received its term or the bridge still has its
    scan, and no worker has received a belief of a later term.
    """

    sender: str
    began_ns: int
    received: list[Checkpoint]
    """The best states of other coordinators."""
    kept: Checkpoint | None = None
    """State from the file."""
    kept_scan: Scan | None = None
    """The last step of the kept state, until the bridge has answered whether it still has it."""
    scan_asked_ns: int | None = None
    asked_ns: dict[str, int | None] = {}
    """When the workers that have not answered were asked; None: not yet."""
    answers: dict[str, WorkerState] = {}
    is_of_this_run: bool = False
    """Whether a worker has received the term of the kept state, or the bridge has its scan."""
    founded: int = 0
    """The highest term of a belief that a worker has received."""

    @property
    def checkpoints(self) -> list[Checkpoint]:
        """The states to continue from, in descending order of rank."""
        return best_first([*self.received, *([self.kept] if self.kept and self._counts else [])])

    @property
    def _counts(self) -> bool:
        kept = self.kept
        return kept is not None and self.is_of_this_run and self.founded <= kept.term

    def expect(self, worker: str) -> None:
        self.asked_ns[worker] = None
        self.answers.pop(worker, None)

    def forget(self, worker: str) -> None:
        self.asked_ns.pop(worker, None)
        self.answers.pop(worker, None)

    def on_checkpoint(self, checkpoint: Checkpoint) -> None:
        self.received = best_first([*self.received, checkpoint])[:MAX_RECEIVED]

    def on_answer(self, worker: str, answer: WorkerState) -> None:
        self.asked_ns.pop(worker, None)
        self.answers[worker] = answer
        self.founded = max(self.founded, answer.founded)
        self.is_of_this_run |= self.kept is not None and self.kept.term in answer.terms

    def on_history(self, scans: Iterable[Scan]) -> None:
        """Process the bridge's answer: a bridge of this run has the last scan of the kept state."""
        kept, self.kept_scan = self.kept_scan, None
        self.is_of_this_run |= kept is not None and any(
            (one.step, one.stamp_ns, one.map_digest) == (kept.step, kept.stamp_ns, kept.map_digest)
            for one in scans
        )

    def drop_checkpoints(self) -> None:
        """Drop the states to continue from, except a kept state that may count later."""
        self.received.clear()
        if self._counts:
            self.kept = None

    def ask_all_again(self) -> None:
        self.asked_ns = dict.fromkeys((*self.asked_ns, *self.answers))

    def questions(self, term: int, now_ns: int) -> list[AskState | FetchScans]:
        due = [worker for worker, ns in sorted(self.asked_ns.items()) if _is_due(ns, now_ns)]
        self.asked_ns |= dict.fromkeys(due, now_ns)
        question = TakeOver(sender=self.sender, term=term)
        questions: list[AskState | FetchScans] = [AskState(worker, question) for worker in due]
        if self.kept_scan is not None and _is_due(self.scan_asked_ns, now_ns):
            self.scan_asked_ns = now_ns
            questions.append(FetchScans(self.kept_scan.step, self.kept_scan.step))
        return questions

    def is_over(self, now_ns: int) -> bool:
        """Return whether to begin without waiting for more workers.

        Without a founded state all places are lost, which must not happen because workers are busy.
        """
        waited_ns = now_ns - self.began_ns
        if self.kept_scan is not None and not self.is_of_this_run and waited_ns < KNOWN_NS:
            return False
        wait_ns = UNKNOWN_NS if len(self.answers) >= len(self.asked_ns) else SILENT_NS
        if any(checkpoint.founded for checkpoint in self.checkpoints):
            wait_ns = KNOWN_NS
        return not self.asked_ns or waited_ns >= wait_ns


def _is_due(asked_ns: int | None, now_ns: int) -> bool:
    return asked_ns is None or now_ns - asked_ns >= ASK_AGAIN_NS
