"""A coordinator's term: a number above those of all earlier terms, which fences older coordinators.

Workers refuse the orders of a lower term, clients ignore its beliefs. Only a coordinator's own
message deposes a coordinator: a worker that claims a higher term may be wrong, or lie.
"""

from protocol.work import Checkpoint

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
        # Two coordinators that hear the same term at once must not choose the same new one.
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
        """Take the highest term that a worker knows; as `hear`, but it deposes nobody."""
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
