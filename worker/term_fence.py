"""Whom a worker obeys: terms fence a coordinator that was taken over from."""

from protocol.errors import OldTermError
from protocol.work import Checkpoint, WorkOrder


class TermFence:
    """The highest term heard of, the last order of it, and the newest checkpoint."""

    def __init__(self) -> None:
        self.term = 0
        self.order = 0
        """The last order followed."""
        self.newest = 0
        """The highest order heard, followed or not."""
        self.checkpoint = b""
        """As it came, for the next coordinator; empty: none was heard."""
        self.step = -1
        """The step of that checkpoint."""
        self._rank: tuple[bool, int, int] = (False, -1, -1)

    def hear(self, term: int) -> None:
        """A coordinator of this term speaks; orders of lower ones are refused from now on."""
        if term > self.term:
            self.term, self.order, self.newest = term, 0, 0

    def keep(self, checkpoint: Checkpoint, payload: bytes) -> None:
        """A checkpoint arrived; an older one is left out."""
        self.hear(checkpoint.term)
        if checkpoint.rank > self._rank:
            self.checkpoint, self.step, self._rank = payload, checkpoint.step, checkpoint.rank

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
