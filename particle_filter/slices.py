"""Long computations in slices of a millisecond or two, so that urgent work can come between."""

from collections.abc import Generator, Iterator
from typing import TypeAlias, TypeVar

T = TypeVar("T")

Slices: TypeAlias = Generator[None, None, T]
"""A generator that yields where it may be interrupted, and returns its result."""

SLICE_WORK = 2**20
"""Work of one slice [table look-ups]; results do not depend on it."""
CALL_WORK = 2**15
"""Overhead of a few numpy calls [table look-ups]."""


class WorkMeter:
    """Ends a slice when enough has been done in it."""

    def __init__(self) -> None:
        self._done = 0

    def spend(self, work: int) -> Iterator[None]:
        """Add work [look-ups]; yields once if the slice is over."""
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
