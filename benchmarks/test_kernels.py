"""Times the kernels and compares each with numpy and C once."""

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from benchmarks.cases import Case, all_cases

WAYS = ("ours", "plain", "floor")
CASES = list(all_cases())


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_all_ways_agree(case: Case) -> None:
    case.check()


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_speed(benchmark: BenchmarkFixture, case: Case, way: str) -> None:
    run = getattr(case, way)
    if run is None:
        pytest.skip("there is no such way, or no C compiler")
    benchmark.group = case.name
    benchmark.extra_info |= {"unit": case.unit, "units": case.units}
    benchmark(run)
