"""Long computations in slices of a millisecond or two: what is more urgent comes in between."""

from collections.abc import Generator, Iterator
from typing import TypeAlias, TypeVar

T = TypeVar("T")

Slices: TypeAlias = Generator[None, None, T]
"""Computes up to where it may be interrupted each time, and returns what came out in the end."""

SLICE_WORK = 2**20
"""Of one slice, in look-ups of a table; where slices end changes no result."""
CALL_WORK = 2**15
"""What a handful of calls of numpy costs, however little they have to do."""


class WorkMeter:
    """Ends a slice when enough has been done in it."""

    def __init__(self) -> None:
        self._done = 0

    def spend(self, work: int) -> Iterator[None]:
        """So much more has been done [look-ups]; yields once if the slice is over."""
        self._done += work + CALL_WORK
        if self._done >= SLICE_WORK:
            self._done = 0
            yield


def finished(slices: Slices[T]) -> T:
    """Compute all slices, one after the other."""
    while True:
        try:
            next(slices)
        except StopIteration as done:
            result: T = done.value
            return result
