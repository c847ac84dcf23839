"""One coordinator's term: how it begins, and when it is over.

A term is a number that stands above those of all terms before. Whoever hears of a higher one no
longer acts: workers refuse its orders, clients its beliefs.
"""

from protocol.work import Checkpoint


class Term:
    """Told of the terms that others know of; says whether this coordinator acts.

    Args:
        number: proposed by a clock.
        known: a checkpoint of another's term, which this one stands above.
    """

    def __init__(self, number: int, known: Checkpoint | None) -> None:
        self._number = max(number, known.term + 1 if known else 0)
        self._begun = False
        self._outranked_by: int | None = None

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
        if number <= self._number:
            return False
        if self._begun:
            self._outranked_by = max(number, self._outranked_by or 0)
        else:
            self._number = number + 1
        return not self._begun
