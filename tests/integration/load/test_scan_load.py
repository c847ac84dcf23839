"""Scans at 40 Hz, every one a step, eight clusters: no step lost, beliefs before the next scan."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.integration.load.programs.scan_load import PLACES, RATE_HZ, run_load


@pytest.mark.soak
@pytest.mark.timeout(1200)
def test_ten_minutes_at_forty_hertz_lose_no_step_and_beliefs_come_before_the_next_scan(
    short_folder: str,
) -> None:
    measured, status = run_load(600.0, Path(short_folder))
    assert (measured.lost, status.steps_lost) == (0, 0), measured.table()
    assert measured.clusters == PLACES
    assert np.percentile(measured.scan_to_belief_s, 99.0) < 1.0 / RATE_HZ, measured.table()


@contextmanager
def other_work(processes: int) -> Iterator[None]:
    """Keep the machine busy with other work."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for one in busy:
            one.kill()
            one.wait()


def test_some_seconds_at_forty_hertz_beside_other_work_lose_no_step(short_folder: str) -> None:
    """An overloaded bridge makes fewer steps of the scans; the delay of a belief is not judged."""
    measured, status = run_load(8.0, Path(short_folder), beside=lambda: other_work(4))
    assert (measured.lost, status.steps_lost) == (0, 0), measured.table()
    assert measured.clusters == PLACES
