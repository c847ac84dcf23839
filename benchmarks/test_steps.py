"""A whole step of the filter in one process."""

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.in_process import steps


@pytest.mark.parametrize("particles", [1_000, 2_000])
def test_a_step_of_ten_clusters(benchmark: BenchmarkFixture, particles: int) -> None:
    going = steps(particles=particles)
    for _ in range(3):
        next(going)
    log_belief = benchmark(next, going)
    assert np.exp(log_belief).sum() == pytest.approx(1.0)
