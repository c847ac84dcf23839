"""Every fuzz test has a bound on memory."""

import resource
from collections.abc import Iterator
from pathlib import Path

import pytest

from clustermcl.filter.settings import SensorSettings
from clustermcl.jobs.warm_up import compile_kernels
from tests.fuzz.effort import ALL_CASES

MAX_GROWTH_MB = 200 + 0.005 * ALL_CASES
"""Hypothesis remembers every case of a test, 50 kB of the largest kind, until the test ends. The
same cases again and again without Hypothesis leave the memory as it is."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@pytest.fixture(scope="session", autouse=True)
def _kernels() -> None:
    """The library of kernels, without which the first test's growth has numba's 130 MB."""
    compile_kernels(SensorSettings())


@pytest.fixture(autouse=True)
def bounded_memory() -> Iterator[None]:
    before_mb = peak_mb()
    yield
    grown_mb = peak_mb() - before_mb
    assert grown_mb < MAX_GROWTH_MB, f"the process's memory grew by {grown_mb:.0f} MB"


def peak_mb() -> float:
    """The most memory that this process ever had."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
