"""Long computations in slices of a millisecond or two, between which urgent work can be done."""

from collections.abc import Generator, Iterator
from typing import TypeAlias, TypeVar

T = TypeVar("T")

Slices: TypeAlias = Generator[None, None, T]
"""A generator that yields where it may be interrupted, and returns its result."""

SLICE_WORK = 2**20
"""Work of one slice [table look-ups]; it does not change results."""
CALL_WORK = 2**15
"""Overhead of a few numpy calls [table look-ups]."""


class WorkMeter:
    """Counts the work of a slice, and ends the slice after `SLICE_WORK`."""

    def __init__(self) -> None:
        self._done = 0

    def spend(self, work: int) -> Iterator[None]:
        """Add work [table look-ups], and yield once if the slice is complete."""
        self._done += work + CALL_WORK
        if self._done >= SLICE_WORK:
            self._done = 0
            yield


def finished(slices: Slices[T]) -> T:
    """Compute all slices without interruption, and return the result."""
    while True:
        try:
            next(slices)
        except StopIteration as done:
            result: T = done.value
            return result
