"""A person tells in which part of the map the robot is."""

from collections.abc import Iterator
from itertools import islice

import numpy as np
import pytest

from clustermcl import ClusterMCL, Reading
from clustermcl.localizer import Belief
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.simulator.worlds.world import World
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import CENTRE, CROSS, REACH_M, is_right

SURE = 1e-6 * np.eye(2)


def beliefs(
    in_world: World, seed: int, ticks: int, words: dict[int, tuple[np.ndarray, float]]
) -> Iterator[tuple[int, Belief, Tick]]:
    """Yield beliefs; words are squares by their tick: low corner and side [m]."""
    mcl = ClusterMCL(in_world.map, settings=SMALL, seed=seed)
    simulation = Simulation(in_world, seed)
    if in_world is not CROSS:
        mcl.set_pose(simulation.map_from_robot)
    for number, tick in enumerate(islice(simulation, ticks)):
        if number in words:
            corner, side_m = words[number]
            mcl.observe(corner, SURE, field=[[0.0]], cell_m=side_m, source="person")
        for reading in (tick.odometry[0], tick.laser, tick.odometry[1]):
            if belief := mcl.update(Reading.of(reading)):
                yield number, belief, tick


@pytest.mark.parametrize("seed", range(6))
def test_one_word_decides_between_four_equal_arms(seed: int) -> None:
    ticks = enumerate(tick.map_from_robot[:2] for tick in Simulation(CROSS, seed))
    word, at = next(
        (n, np.array(at) - CENTRE) for n, at in ticks if n > 80 and max(map(abs, at)) > 2
    )
    axis = np.abs(at).argmax()
    arm = np.zeros(2)
    arm[axis] = np.copysign(REACH_M + 1.0, at[axis])
    square = CENTRE + arm - REACH_M, 2.0 * REACH_M  # from 1 m off the centre on
    steps = list(beliefs(CROSS, seed, word + 60, {word: square}))
    before = [belief.state for number, belief, _ in steps if number < word]
    after = [(belief, tick) for number, belief, tick in steps if number >= word]
    assert "localized" not in before
    assert len(after) > 1
    assert all(belief.state == "localized" and is_right(belief, tick) for belief, tick in after)


@pytest.mark.parametrize("seed", range(3))
def test_the_laser_outvotes_a_wrong_word(seed: int) -> None:
    """A localized robot; every 10 s a person says that it is on the other side of the office."""
    office = world("office")
    start = np.array(Simulation(office, seed).map_from_robot[:2])
    assert np.hypot(*start) > 20.0
    words = dict.fromkeys(range(50, 300, 100), (-start - 2.5, 5.0))
    steps = list(beliefs(office, seed, 300, words))
    assert len(steps) > 20
    assert all(is_right(belief, tick) for _, belief, tick in steps)
