"""Waiting for a condition instead of sleeping."""

import os
import threading
import time
from collections.abc import Callable

import pytest

_POLL_S = 0.005


def wait_until(condition: Callable[[], object], deadline_s: float = 20.0) -> None:
    """Return as soon as the condition holds; fail the test if it never does.

    Args:
        condition: looked at every few milliseconds.
        deadline_s: how long the slowest machine may take [s]; passing tests do not wait it out.
    """
    until_s = time.monotonic() + deadline_s
    nap = threading.Event()
    while not condition():
        if time.monotonic() >= until_s:
            pytest.fail(f"{condition} did not hold within {deadline_s:g} s")
        nap.wait(_POLL_S)


def stretched_s(promised_s: float) -> float:
    """A promised time, stretched by how many processes want each core: 1 on a machine with time."""
    return promised_s * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
