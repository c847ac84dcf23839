"""Every fuzz test has a bound on memory."""

import resource
from collections.abc import Iterator

import pytest

MAX_GROWTH_MB = 300
"""Hypothesis itself keeps some ten megabytes; the largest input is a tenth of a megabyte."""


@pytest.fixture(autouse=True)
def bounded_memory() -> Iterator[None]:
    before_mb = peak_mb()
    yield
    grown_mb = peak_mb() - before_mb
    assert grown_mb < MAX_GROWTH_MB, f"the process's memory grew by {grown_mb:.0f} MB"


def peak_mb() -> float:
    """The most memory that this process ever had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
