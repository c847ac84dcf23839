"""Returns freed heap memory to the operating system (glibc)."""

import ctypes

ARENAS = 2
_M_ARENA_MAX = -8  # of malloc.h
SETTLED_S = 5.0
"""Wait this long after a large message, until its memory has been freed [s]."""


def _glibc(function: str, *numbers: int) -> None:
    if found := getattr(ctypes.CDLL(None), function, None):
        found(*numbers)


def share_arenas() -> None:
    """Limit glibc to `ARENAS` malloc arenas; call it before threads allocate.

    The default is eight per core, and each keeps its peak size: Zenoh's threads fill one after
    the other. Does nothing without glibc.
    """
    _glibc("mallopt", _M_ARENA_MAX, ARENAS)


def trim_heap() -> None:
    """Call glibc's ``malloc_trim``, which takes some milliseconds; does nothing without glibc.

    By itself glibc shrinks a heap only from its end. Where many threads allocate and free, the
    rest grows with every burst of large messages and looks like a leak.
    """
    _glibc("malloc_trim", 0)
