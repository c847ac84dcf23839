from collections.abc import Iterator
from itertools import islice

import numpy as np

from clustermcl import ClusterMCL, Reading
from clustermcl.filter.poses import compose
from clustermcl.protocol.steps import Landmark
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import SIGMA_M, is_right, sight

OFFICE = world("office")
SEEDS = range(4)


def first_after_kidnapping(seed: int, *, observes: bool = True) -> tuple[bool, bool]:
    """Return whether the most probable place is right before, and at the first step after."""
    simulation, rng = Simulation(OFFICE, seed), np.random.default_rng(seed)
    target = Simulation(OFFICE, 1000 + seed).kidnap()
    x, y, _ = compose(np.array(target), np.array([1.5, 0.4, 0.0])).tolist()
    tag = Landmark(name="exit", x=x, y=y, sigma=0.05)
    mcl = ClusterMCL(OFFICE.map, landmarks=[tag], settings=SMALL, seed=seed)
    mcl.set_pose(simulation.map_from_robot)
    *_, before = rights(mcl, islice(simulation, 100), rng, ())
    simulation.kidnap(target)
    after = rights(mcl, islice(simulation, 20), rng, (tag,) if observes else ())
    return before, next(after)


def rights(
    mcl: ClusterMCL, ticks: Iterator[Tick], rng: np.random.Generator, tags: tuple[Landmark, ...]
) -> Iterator[bool]:
    for tick in ticks:
        seen = sight(tick, rng, tags=tags)
        for reading in (tick.odometry[0], tick.laser, tick.odometry[1]):
            if reading is tick.laser and seen is not None:
                name, position = seen
                covariance = np.eye(2) * SIGMA_M**2
                mcl.observe(position, covariance, landmark=name, stamp_ns=tick.laser.stamp_ns)
            if belief := mcl.update(Reading.of(reading)):
                yield is_right(belief, tick)


def test_the_robot_is_localized_at_the_first_observation() -> None:
    """In one run, another pose in sight of the tag fits the first scan better."""
    before, after = zip(*map(first_after_kidnapping, SEEDS), strict=True)
    assert all(before)
    assert sum(after) >= 3


def test_without_observations_localization_takes_longer() -> None:
    found = [first_after_kidnapping(seed, observes=False) for seed in SEEDS[:3]]
    assert found == [(True, False)] * 3
