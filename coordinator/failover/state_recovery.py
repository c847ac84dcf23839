"""What a new coordinator asks before it acts: the workers tell what the last one had decided."""

from collections import deque
from collections.abc import Iterable, Mapping
from itertools import chain
from typing import TypeVar

import msgspec

from coordinator.failover.trust import Trust
from coordinator.instructions import AskState
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.validity import assignment_problem
from protocol.work import Assignment, Checkpoint, Report, TakeOver, WorkerState

ASK_AGAIN_NS = 200_000_000
"""A worker whose token is there may not serve the question yet."""
ORDERS_AFTER_NS = 2_000_000_000
"""A worker that does not say what it does gets orders all the same after so long."""
MAX_EARLIER = 3
"""Checkpoints of one worker's beside the newest; see `worker.term_fence`."""
MAX_HEARD = 4
"""Checkpoints that others publish while this coordinator has not begun."""
KNOWN_NS, UNKNOWN_NS = 500_000_000, 3_000_000_000
"""So long a beginner waits for the last worker, with a checkpoint of places and without."""
SILENT_NS = 30_000_000_000
"""So long it waits without one while most are silent: busy as they are, they know it."""


M = TypeVar("M")


class Told(msgspec.Struct, frozen=True):
    """A worker's answer, decoded."""

    term: int
    holds: tuple[Assignment, ...]
    checkpoint: Checkpoint | None
    reports: tuple[Report, ...]
    earlier: tuple[Checkpoint, ...] = ()
    """Others to carry on from."""

    @property
    def checkpoints(self) -> tuple[Checkpoint, ...]:
        """All of them."""
        return ((self.checkpoint,) if self.checkpoint else ()) + self.earlier


def told_by(payload: bytes, trust: Trust) -> Told:
    """A worker's answer with all that is packed in it.

    Raises:
        MalformedMessageError: it is no worker's answer; what is malformed inside one, or not to
            be believed, is left out.
    """
    state = decode(payload, WorkerState)
    packed = [one for one in (state.checkpoint, *state.earlier[:MAX_EARLIER]) if one]
    checkpoints = [one for one in _decoded(packed, Checkpoint) if trust.believes(one)]
    reports: list[Report] = _decoded(state.reports, Report)  # type: ignore[arg-type] # a union
    return Told(
        term=trust.term(state),
        holds=_possible(state.holds),
        checkpoint=checkpoints[0] if checkpoints else None,
        reports=tuple(reports),
        earlier=tuple(checkpoints[1:]),
    )


def best_first(checkpoints: Iterable[Checkpoint]) -> list[Checkpoint]:
    """Each once, in the order in which they are worth carrying on from."""
    once = {(one.rank, one.state): one for one in checkpoints}
    return sorted(once.values(), key=lambda one: one.rank, reverse=True)


def _possible(assignments: Iterable[Assignment]) -> tuple[Assignment, ...]:
    return tuple(held for held in assignments if assignment_problem(held) is None)


def _decoded(payloads: Iterable[bytes], kind: type[M]) -> list[M]:
    found = []
    for payload in payloads:
        try:
            found.append(decode(payload, kind))
        except MalformedMessageError:
            continue
    return found


class StateRecovery:
    """Who has to be asked, who has answered, and what is the newest checkpoint."""

    def __init__(self, sender: str, known: Checkpoint | None, now_ns: int) -> None:
        self._sender = sender
        self._began_ns = now_ns
        self._asked_ns: dict[str, int | None] = {}
        self._told: dict[str, Told] = {}
        self._heard = deque([known] if known else [], MAX_HEARD)
        self._kept: dict[str, tuple[Checkpoint, ...]] = {}
        """By the worker that told them, also if it has gone since."""

    @property
    def told(self) -> Mapping[str, Told]:
        """The answers of the workers that are there."""
        return self._told

    @property
    def checkpoints(self) -> list[Checkpoint]:
        """Those of other coordinators, the best to carry on from first."""
        return best_first(chain(self._heard, *self._kept.values()))

    def expect(self, worker: str) -> None:
        """A worker is there and has to be asked."""
        self._asked_ns[worker] = None
        self._told.pop(worker, None)

    def forget(self, worker: str) -> None:
        """A worker is gone."""
        self._asked_ns.pop(worker, None)
        self._told.pop(worker, None)

    def hear(self, checkpoint: Checkpoint) -> None:
        """Another coordinator has published a checkpoint."""
        self._heard.append(checkpoint)

    def answered(self, worker: str, told: Told) -> None:
        """A worker has answered; one that has started anew meanwhile knows less than before."""
        self._asked_ns.pop(worker, None)
        self._told[worker] = msgspec.structs.replace(told, checkpoint=None, earlier=())
        known = chain(told.checkpoints, self._kept.get(worker, ()))
        self._kept[worker] = tuple(best_first(known)[: MAX_EARLIER + 1])

    def forget_checkpoints(self) -> None:
        """This coordinator has begun, from one of them or from none: they are of no use."""
        self._heard.clear()
        self._kept.clear()

    def forget_told(self) -> None:
        """This coordinator has a belief of its own: nobody carries on from theirs any more."""
        self._told.clear()

    def ask_all_again(self) -> None:
        """All must be asked anew: the term was too low."""
        for worker in (*self._asked_ns, *self._told):
            self._asked_ns[worker] = None

    def questions(self, term: int, now_ns: int) -> list[AskState]:
        """Whom to ask now, in the name of a term."""
        due = [
            worker
            for worker, asked_ns in sorted(self._asked_ns.items())
            if asked_ns is None or now_ns - asked_ns >= ASK_AGAIN_NS
        ]
        for worker in due:
            self._asked_ns[worker] = now_ns
        return [AskState(worker, TakeOver(sender=self._sender, term=term)) for worker in due]

    def is_over(self, now_ns: int) -> bool:
        """Whether to wait for no more workers before beginning.

        Who begins without a checkpoint may forget all places: not because workers are busy.
        """
        waited_ns = now_ns - self._began_ns
        if any(checkpoint.founded for checkpoint in self.checkpoints):
            wait_ns = KNOWN_NS
        elif len(self._told) >= len(self._asked_ns):
            wait_ns = UNKNOWN_NS
        else:
            wait_ns = SILENT_NS
        return not self._asked_ns or waited_ns >= wait_ns
