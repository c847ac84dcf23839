"""Coordinators, workers and the bridge keep the laws in thousands of schedules of faults.

A seed that fails is run again by ``python -m tests.simulation --first SEED --schedules 1``.
200 run here, and 2,000 by that command in .ci/run.
"""

import random
from collections.abc import Iterator
from multiprocessing.pool import Pool

import pytest

from tests.simulation.many import broken, processes
from tests.simulation.schedule import Fault, Schedule
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


def killed(name: str, away_s: float) -> Fault:
    def fault(simulation: Simulation) -> None:
        node = simulation.network.nodes[name]
        simulation.network.kill(node)
        simulation.clock.after(away_s, lambda: simulation.network.start(node))

    return fault


class BridgeAway(Schedule):
    """All coordinators die while the bridge is away, and return before it."""

    def __init__(self, rng: random.Random) -> None:
        super().__init__(rng)
        self.workers, self.loss, self.doubled, self.lockstep = 2, 0.0, 0.0, False
        kills = [(5.0, "bridge", 2.0), (5.2, "c0", 0.05), (5.2, "c1", 0.3)]
        self.faults = [(at_s, killed(name, away_s)) for at_s, name, away_s in kills]
        self.calm_at_s = 9.0


def test_the_belief_is_kept_by_a_coordinator_that_restarts_without_a_bridge() -> None:
    simulation = Simulation(1, symmetric_room(), BridgeAway)
    simulation.run()
    first, successor = (life for life in simulation.laws.lives if life.decided)
    assert successor.started.known is None, "it has its own file only"
    assert successor.decided[: len(first.decided)] == first.decided
    assert len(successor.decided) > len(first.decided)
    assert not simulation.laws.restarts_count, "the bridge continues the steps"


def test_a_seed_determines_its_schedule() -> None:
    model, seen = symmetric_room(), []
    for seed in (3, 3, 4):
        simulation = Simulation(seed, model)
        simulation.run()
        seen.append((simulation.clock.now_ns, sorted(simulation.laws.published)))
    assert seen[0] == seen[1] != seen[2]
