"""A person sets the robot's pose, rightly or wrongly: the laser decides."""

from itertools import islice

import pytest

from clustermcl import ClusterMCL, Reading
from clustermcl.localizer import Belief
from robot_simulator.simulation import Simulation
from robot_simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import is_right

OFFICE = world("office")
TICKS, FIRST = 120, 40


def drive(seed: int, *, right: bool, start_right: bool, every: int, times: int) -> list[bool]:
    """Return whether each belief after the first word is right, and none sure and wrong.

    Args:
        seed: of the robot.
        right: whether the words are right.
        start_right: whether the filter begins at the right place.
        every: steps from one word to the next; 0: all at once.
        times: number of words.
    """
    simulation, mcl = Simulation(OFFICE, seed), ClusterMCL(OFFICE.map, settings=SMALL, seed=seed)
    wrong_pose = Simulation(OFFICE, seed + 1000).map_from_robot
    mcl.set_pose(simulation.map_from_robot if start_right else wrong_pose)
    rights: list[bool] = []
    words, steps = 0, 0
    for number, tick in enumerate(islice(simulation, TICKS)):
        for reading in (tick.odometry[0], tick.laser, tick.odometry[1]):
            belief = mcl.update(Reading.of(reading))
            if belief is None:
                continue
            steps += 1
            if words:
                rights.append(is_right(belief, tick))
                assert belief.state != "localized" or rights[-1]
            is_due = number >= FIRST and words < times and (every == 0 or steps % every == 0)
            for _ in range(0 if not is_due else 1 if every else times):
                mcl.set_pose(tick.map_from_robot if right else wrong_pose)
                words += 1
                given: Belief | None = mcl.belief
                assert given is not None
                if right:
                    assert is_right(given, tick), "the robot is there at once"
    assert len(rights) > 10
    return rights


@pytest.mark.parametrize(("every", "times"), [(0, 1), (0, 10), (1, 10)])
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_pose_is_outvoted_within_three_steps_however_often_it_is_given(
    seed: int, every: int, times: int
) -> None:
    rights = drive(seed, right=False, start_right=True, every=every, times=times)
    assert all(rights[3:])


@pytest.mark.parametrize("start_right", [True, False])
def test_a_right_pose_is_taken_at_once(start_right: bool) -> None:
    for seed in range(3):
        assert all(drive(seed, right=True, start_right=start_right, every=0, times=1))
