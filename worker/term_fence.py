"""Whom a worker obeys: terms fence a coordinator that was taken over from."""

from collections import deque
from dataclasses import dataclass

from protocol.errors import OldTermError
from protocol.work import Checkpoint, WorkOrder

CONFIRMED = 2
"""Confirmed checkpoints that are kept beside the newest."""


@dataclass(frozen=True)
class KeptCheckpoint:
    """A checkpoint, unread."""

    rank: tuple[bool, int, int]
    term: int
    step: int
    payload: bytes
    """As it came."""


class TermFence:
    """The highest term heard of, the last order of it, and checkpoints for the next coordinator.

    Beside the newest checkpoint the last two are kept that an acting coordinator has confirmed.
    One acts when it has given this worker an order in its term, and confirms a checkpoint of that
    term by carrying on: it says that one again, or a later one, or works until another takes over.
    Whoever only publishes a checkpoint, and be it one that nobody can read, so replaces none that
    is good.
    """

    def __init__(self) -> None:
        self.term = 0
        self.term_proof = b""
        """As it came with the term; see `WorkOrder.term_proof`."""
        self.order = 0
        """The last order followed."""
        self.newest = 0
        """The highest order heard, followed or not."""
        self._acting = -1
        """The highest term of an order."""
        self._best: KeptCheckpoint | None = None
        self._last: KeptCheckpoint | None = None
        """The last one of a term that rules, whatever its rank."""
        self._confirmed: deque[KeptCheckpoint] = deque(maxlen=CONFIRMED)

    @property
    def checkpoint(self) -> bytes:
        """That of the highest rank, as it came; empty: none was heard."""
        return self._best.payload if self._best else b""

    @property
    def earlier(self) -> tuple[bytes, ...]:
        """The last one heard, if it is another, and the confirmed ones, newest first."""
        payloads = dict.fromkeys(kept.payload for kept in self._kept())
        return tuple(payload for payload in payloads if payload != self.checkpoint)

    @property
    def step(self) -> int:
        """The step of the oldest checkpoint that is kept; -1: none is."""
        return min((kept.step for kept in self._kept()), default=-1)

    def hear(self, term: int, term_proof: bytes = b"") -> None:
        """A coordinator of this term speaks; orders of lower ones are refused from now on."""
        if term > self.term:
            self.term, self.term_proof, self.order, self.newest = term, term_proof, 0, 0

    def keep(self, checkpoint: Checkpoint, payload: bytes) -> None:
        """A checkpoint arrived; it may confirm the one before."""
        self.hear(checkpoint.term, checkpoint.term_proof)
        kept = KeptCheckpoint(checkpoint.rank, checkpoint.term, checkpoint.step, payload)
        if self._best is None or kept.rank > self._best.rank:
            self._best = kept
        if kept.term < self.term:
            return
        if self._last is not None and self._confirms(kept, self._last):
            self._confirm(self._last)
        self._last = kept

    def _confirms(self, kept: KeptCheckpoint, before: KeptCheckpoint) -> bool:
        """Whether `before` is of the acting coordinator, and what follows it goes on from it."""
        goes_on = kept.term > before.term or kept.rank >= before.rank
        return before.term == self._acting and goes_on

    def _confirm(self, kept: KeptCheckpoint) -> None:
        if not self._confirmed or kept.rank > self._confirmed[-1].rank:
            self._confirmed.append(kept)

    def _kept(self) -> list[KeptCheckpoint]:
        kept = (self._best, self._last, *reversed(self._confirmed))
        return [one for one in kept if one is not None]

    def check(self, order: WorkOrder) -> bool:
        """Whether to follow an order; False for one that a later one has overtaken.

        Raises:
            OldTermError: it is of a coordinator that was taken over from.
        """
        if order.term < self.term:
            raise OldTermError(term=order.term, ruling=self.term)
        self.hear(order.term, order.term_proof)
        self._acting = order.term
        if order.order < self.newest:
            return False
        self.newest = order.order
        return True
