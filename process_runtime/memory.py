"""Memory that was freed goes back to the operating system."""

import ctypes
import sys

ARENAS = 2
_M_ARENA_MAX = -8  # of malloc.h
SETTLED_S = 5.0
"""After something large: what it was needed for is over."""


def share_arenas() -> None:
    """Let all threads of this process allocate from a few arenas; call it before they do.

    By itself glibc makes eight for each core, and each of them keeps what was its most: Zenoh's
    threads fill one after the other. Without glibc, nothing happens.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, ARENAS)


def give_back_freed_memory() -> None:
    """Give back what the C library keeps of freed memory; it does so by itself only at its end.

    Where many threads allocate and free, as Zenoh's do, that grows with every burst of large
    messages and looks like a leak. Takes some milliseconds; without glibc, nothing happens.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)


class AfterLargeMessages:
    """Gives memory back a while after large messages, such as those of a take-over."""

    def __init__(self) -> None:
        self._due_s: float | None = None

    def passed(self, now_s: float) -> None:
        """There was one."""
        self._due_s = now_s + SETTLED_S

    def turn(self, now_s: float) -> bool:
        """Give back if it is time; whether it was."""
        if self._due_s is None or now_s < self._due_s:
            return False
        self._due_s = None
        give_back_freed_memory()
        return True
