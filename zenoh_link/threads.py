"""Sets Zenoh's number of receiving threads, which only an environment variable can set."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

VARIABLE = "ZENOH_RUNTIME"

ONE_LINK = "(rx: (worker_threads: 1))"
"""A client has one link; each message would wake a second thread for nothing."""

MANY_LINKS = "(rx: (worker_threads: 16))"
"""For a router or a peer: more threads than a machine has links.

When a link dies silently (cable, switch, radio), its lease expires and a receiving thread closes
it; close(2) then blocks up to 10 s for unacknowledged bytes. With Zenoh's default of two threads,
two dead links block all others.
"""

_one_at_a_time = threading.Lock()
_read = False


@contextmanager
def receiving_threads(runtime: str) -> Iterator[None]:
    """Open a session within this context; the first session of a process decides for all.

    Zenoh reads the variable when the first session is opened. It is removed again because child
    processes inherit it: a router started by a client would have one thread. A value that the
    environment already has is kept.

    Args:
        runtime: `ONE_LINK` or `MANY_LINKS`.
    """
    global _read  # noqa: PLW0603 - Zenoh reads once for the whole process, too
    if _read or VARIABLE in os.environ:
        yield
        return
    with _one_at_a_time:
        os.environ[VARIABLE] = runtime
        try:
            yield
        finally:
            del os.environ[VARIABLE]
            _read = True
