"""One coordinator's term: how it begins, and when it is over.

A term is a number that stands above those of all terms before. Whoever hears of a higher one no
longer acts: workers refuse its orders, clients its beliefs.
"""

from protocol.work import Checkpoint

APART_US = 1_000_000
"""So far above all terms that it hears of a coordinator begins. The epochs of a term's jobs are
counted from the term on, and none may come again in the next one."""


class Term:
    """Told of the terms that others know of; says whether this coordinator acts.

    Args:
        number: proposed by a clock [us].
        known: checkpoints of others' terms, which this one stands above.
    """

    def __init__(self, number: int, *known: Checkpoint | None) -> None:
        self._number = number
        self._own_us = number % APART_US
        """Two that hear of the same term at once must not be raised to the same one."""
        self._begun = False
        self._outranked_by: int | None = None
        for checkpoint in known:
            if checkpoint is not None:
                self.hear(checkpoint.term)

    @property
    def number(self) -> int:
        """The term; it is fixed once it has begun."""
        return self._number

    @property
    def begun(self) -> bool:
        """Whether this coordinator acts, or has acted."""
        return self._begun

    @property
    def outranked_by(self) -> int | None:
        """A higher term that somebody knows of: another coordinator acts, this one must not."""
        return self._outranked_by

    def begin(self) -> None:
        """All is known that is needed to act."""
        self._begun = True

    def hear(self, number: int) -> bool:
        """Somebody knows of a term; returns whether this one was raised above it."""
        if self._begun:
            if number > self._number:
                self._outranked_by = max(number, self._outranked_by or 0)
            return False
        if number == self._number or number + APART_US <= self._number:
            return False
        self._number = (number // APART_US + 2) * APART_US + self._own_us
        return True
