"""Whom a worker obeys: terms fence a coordinator that was taken over from."""

from collections import deque

from protocol.errors import OldTermError
from protocol.work import Checkpoint, WorkOrder

KEPT_TERMS = 16
"""More coordinators than ask one after the other before one of them begins."""


class TermFence:
    """The terms heard of, and the last order of the highest."""

    def __init__(self) -> None:
        self.term = 0
        """The highest."""
        self.founded = 0
        """The highest term of a checkpoint that was founded."""
        self.order = 0
        """The last order followed."""
        self.newest = 0
        """The highest order heard, followed or not."""
        self._terms: deque[int] = deque(maxlen=KEPT_TERMS)

    @property
    def terms(self) -> tuple[int, ...]:
        """The last ones heard of, in the order in which they were."""
        return tuple(self._terms)

    def hear(self, term: int) -> None:
        """A coordinator of this term speaks; orders of lower ones are refused from now on."""
        if term and term not in self._terms:
            self._terms.append(term)
        if term > self.term:
            self.term, self.order, self.newest = term, 0, 0

    def on_checkpoint(self, checkpoint: Checkpoint) -> None:
        """A coordinator lives that has begun."""
        self.hear(checkpoint.term)
        if checkpoint.founded:
            self.founded = max(self.founded, checkpoint.term)

    def check(self, order: WorkOrder) -> bool:
        """Whether to follow an order; False for one that a later one has overtaken.

        Raises:
            OldTermError: it is of a coordinator that was taken over from.
        """
        if order.term < self.term:
            raise OldTermError(term=order.term, ruling=self.term)
        self.hear(order.term)
        if order.order < self.newest:
            return False
        self.newest = order.order
        return True
