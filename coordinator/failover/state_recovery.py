"""What a new coordinator asks before it acts: the workers tell what the last one had decided."""

from collections import deque
from collections.abc import Iterable, Mapping
from typing import TypeVar

import msgspec

from coordinator.instructions import AskState
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.terms import check_term
from protocol.validity import assignment_problem
from protocol.work import Assignment, Checkpoint, Report, TakeOver, WorkerState

ASK_AGAIN_NS = 200_000_000
"""A worker whose token is there may not serve the question yet."""
ORDERS_AFTER_NS = 2_000_000_000
"""A worker that does not say what it does gets orders all the same after so long."""
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
    holds: tuple[Assignment, ...] = ()
    reports: tuple[Report, ...] = ()
    terms: tuple[int, ...] = ()
    founded: int = 0


def told_by(payload: bytes, clock_ns: int) -> Told:
    """Decode a worker's answer and the messages packed in it; malformed ones are left out.

    Args:
        payload: from the wire.
        clock_ns: local time since 1970.

    Raises:
        MalformedMessageError: it is no worker's answer, or names an impossible term.
    """
    state = decode(payload, WorkerState)
    check_term(state, clock_ns)
    reports: list[Report] = _decoded(state.reports, Report)  # type: ignore[arg-type] # a union
    return Told(
        term=state.term,
        holds=_possible(state.holds),
        reports=tuple(reports),
        terms=state.terms,
        founded=state.founded,
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
    """Who has to be asked, who has answered, and which checkpoints there are to carry on from.

    What others have published meanwhile can be carried on from. What the file holds may be of
    another life of the whole system: it counts as soon as a worker knows its term, and as long as
    none knows of a belief of a later one.

    Args:
        sender: of this coordinator.
        known: what another published last, as this one stood by.
        kept: what the file holds.
        now_ns: by the clock of all events.
    """

    def __init__(
        self, sender: str, known: Checkpoint | None, kept: Checkpoint | None, now_ns: int
    ) -> None:
        self._sender = sender
        self._began_ns = now_ns
        self._asked_ns: dict[str, int | None] = {}
        self._told: dict[str, Told] = {}
        self._heard = deque([known] if known else [], MAX_HEARD)
        self._kept = kept
        self._is_of_this_life = False
        """What is kept."""
        self._founded = 0
        """The highest term of a belief that a worker has heard of."""

    @property
    def told(self) -> Mapping[str, Told]:
        """The answers of the workers that are there."""
        return self._told

    @property
    def checkpoints(self) -> list[Checkpoint]:
        """Those of other coordinators, the best to carry on from first."""
        kept = [self._kept] if self._kept and self._counts(self._kept) else []
        return best_first([*self._heard, *kept])

    def _counts(self, kept: Checkpoint) -> bool:
        return self._is_of_this_life and self._founded <= kept.term

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
        """A worker has answered."""
        self._asked_ns.pop(worker, None)
        self._told[worker] = told
        self._founded = max(self._founded, told.founded)
        self._is_of_this_life |= self._kept is not None and self._kept.term in told.terms

    def forget_checkpoints(self) -> None:
        """This coordinator has begun, from one of them or from none: they are of no use."""
        self._heard.clear()
        if self._kept and self._counts(self._kept):
            self._kept = None

    def forget_told(self) -> None:
        """This coordinator has a belief of its own: nobody carries on from theirs any more."""
        self._told.clear()
        self._kept = None

    def ask_all_again(self) -> None:
        """All must be asked anew: the term was too low."""
        for worker in (*self._asked_ns, *self._told):
            self._asked_ns[worker] = None

    def questions(self, term: int, applied: int, now_ns: int) -> list[AskState]:
        """Whom to ask now, in the name of a term; `applied` is this one's own last step."""
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
