"""Memory that was freed goes back to the operating system."""

import ctypes
import sys


def give_back_freed_memory() -> None:
    """Give back what the C library keeps of freed memory; it does so by itself only at its end.

    Where many threads allocate and free, as Zenoh's do, that grows with every burst of large
    messages and looks like a leak. Takes some milliseconds; without glibc, nothing happens.
    """
    if sys.platform == "linux":
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
