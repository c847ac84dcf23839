"""How many threads Zenoh receives with: only an environment variable can tell it."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

VARIABLE = "ZENOH_RUNTIME"

ONE_LINK = "(rx: (worker_threads: 1))"
"""A client has one link, and a second thread would be woken for nothing by each message."""

MANY_LINKS = "(rx: (worker_threads: 16))"
"""Of a router or a peer: more than a machine has links.

When a link dies silently (a cable, a switch, a radio), its lease runs out and a receiving thread
closes it; close(2) then waits up to 10 s for bytes that nobody will acknowledge. Zenoh has two
such threads by itself: two dead links, and nobody is served meanwhile.
"""

_one_at_a_time = threading.Lock()
_read = False


@contextmanager
def receiving_threads(runtime: str) -> Iterator[None]:
    """Open a session in here; the first one of a process decides for all.

    Zenoh reads the variable when the first session of a process is opened. It is taken away again,
    for children inherit it: a router that a client starts would have one thread. What a person has
    set stays as it is.

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
