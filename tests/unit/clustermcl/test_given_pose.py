"""A person sets the robot's pose, rightly or wrongly: it is the belief, until the laser differs."""

from itertools import islice

import pytest

from clustermcl import ClusterMCL, Reading
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import is_right

HALL = world("hall")
TICKS, GIVEN_AT, FOUND_WITHIN = 160, 40, 20


@pytest.mark.parametrize("is_wrong", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_a_given_pose_is_taken_at_once_and_a_wrong_one_is_found(seed: int, is_wrong: bool) -> None:
    """The robot was sure of its place before if the pose is wrong, and of a wrong one if not."""
    simulation, mcl = Simulation(HALL, seed), ClusterMCL(HALL.map, settings=SMALL, seed=seed)
    wrong_pose = Simulation(HALL, seed + 1000).map_from_robot
    mcl.set_pose(simulation.map_from_robot if is_wrong else wrong_pose)
    rights: list[bool] = []
    before = next(simulation)
    for number, tick in enumerate(islice(simulation, TICKS)):
        if number == GIVEN_AT:
            mcl.set_pose(wrong_pose if is_wrong else before.map_from_robot)
            assert mcl.belief is not None
            assert len(mcl.belief.hypotheses) == 1, "nothing else is left"
            assert is_right(mcl.belief, before) != is_wrong
        before = tick
        for reading in (tick.odometry[0], tick.laser, tick.odometry[1]):
            belief = mcl.update(Reading.of(reading))
            if belief is not None and number >= GIVEN_AT:
                rights.append(is_right(belief, tick))
                assert belief.state != "localized" or rights[-1] or len(rights) < FOUND_WITHIN
    assert all(rights) or is_wrong
    assert len(rights) > 20
    assert all(rights[FOUND_WITHIN:])
