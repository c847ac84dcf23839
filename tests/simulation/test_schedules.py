"""Coordinators, workers and the bridge keep the laws in thousands of schedules of faults.

A seed that fails is run again by ``python -m tests.simulation --first SEED --schedules 1``.
200 run here, and 1,000 by that command in .ci/run.
"""

from collections.abc import Iterator
from multiprocessing.pool import Pool

import pytest

from tests.simulation.many import broken, processes
from tests.simulation.simulation import Simulation
from tests.unit.coordinator.living import symmetric_room

SCHEDULES = 200
PARTS = 20
"""Each a test, so that one stays within a test's time on a machine that has too much to do."""


@pytest.fixture(scope="module")
def pool() -> Iterator[Pool]:
    with processes() as made:
        yield made


@pytest.mark.parametrize("part", range(PARTS))
def test_all_laws_hold_in_every_schedule(pool: Pool, part: int) -> None:
    assert list(broken(pool, range(part, SCHEDULES, PARTS))) == []


def test_a_seed_determines_its_schedule() -> None:
    model, seen = symmetric_room(), []
    for seed in (3, 3, 4):
        simulation = Simulation(seed, model)
        simulation.run()
        seen.append((simulation.clock.now_ns, sorted(simulation.laws.published)))
    assert seen[0] == seen[1] != seen[2]
