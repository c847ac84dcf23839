"""A client that queries the pose repeatedly during a fault."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from process_runtime.stop import StopFlag
from tests.integration.faults.system import System

EVERY_S = 0.2


@contextmanager
def asked_all_along(tested: System) -> Iterator[Callable[[], float]]:
    """Ask for the pose in a thread of its own, five times a second.

    Yields:
        How long the slowest answer took until now, or takes by now [s].
    """
    stop = StopFlag()
    longest_s, asked_s = 0.0, time.monotonic()

    def longest() -> float:
        return max(longest_s, time.monotonic() - asked_s)

    def ask() -> None:
        nonlocal longest_s, asked_s
        with tested.client as client:
            while not stop.wait(EVERY_S):
                asked_s = time.monotonic()
                client.pose()
                longest_s = longest()

    asker = threading.Thread(target=ask)
    asker.start()
    try:
        yield longest
    finally:
        stop.set()
        asker.join()
