"""Work that goes on in a thread next to a test."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from clustermcl.runtime.stop import StopFlag


@contextmanager
def running(work: Callable[[StopFlag], object]) -> Iterator[StopFlag]:
    """Run it until the end of the ``with`` block, which sets its stop flag and waits for it."""
    stop = StopFlag()
    thread = threading.Thread(target=work, args=(stop,))
    thread.start()
    try:
        yield stop
    finally:
        stop.set()
        thread.join()
