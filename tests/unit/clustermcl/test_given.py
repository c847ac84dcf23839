"""What persons and other programs say of the pose, rightly or wrongly."""

from itertools import count, islice

import numpy as np
import pytest

from clustermcl import ClusterMCL
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import CENTRE, CROSS, OFFICE, REACH_M, driven, is_right

HALL = world("hall")
TICKS, GIVEN_AT, FOUND_WITHIN = 160, 40, 20
FROM, FLOOD = 40, 60
"""First tick of the false poses, and number of ticks of a flood of names, 6 s."""


@pytest.mark.parametrize("is_wrong", [False, True])
@pytest.mark.parametrize("seed", [1, 2, 5])  # 0 takes 55 steps, with so few particles
def test_a_given_pose_is_taken_at_once_and_a_wrong_one_is_found(seed: int, is_wrong: bool) -> None:
    """The robot was sure of its place before if the pose is wrong, and of a wrong one if not."""
    simulation, mcl = Simulation(HALL, seed), ClusterMCL(HALL.map, settings=SMALL, seed=seed)
    wrong_pose = Simulation(HALL, seed + 1000).map_from_robot
    mcl.set_pose(simulation.map_from_robot if is_wrong else wrong_pose)
    *ticks, before = islice(simulation, 1, GIVEN_AT + 1)
    assert list(driven(mcl, [*ticks, before]))
    mcl.set_pose(wrong_pose if is_wrong else before.map_from_robot)
    assert mcl.belief is not None
    assert len(mcl.belief.hypotheses) == 1, "nothing else is left"
    assert is_right(mcl.belief, before) != is_wrong
    rights: list[bool] = []
    for belief, tick in driven(mcl, islice(simulation, TICKS - GIVEN_AT)):
        rights.append(is_right(belief, tick))
        assert belief.state != "localized" or rights[-1] or len(rights) < FOUND_WITHIN
    assert all(rights) or is_wrong
    assert len(rights) > FOUND_WITHIN
    assert all(rights[FOUND_WITHIN:])


@pytest.mark.filterwarnings("ignore:(too many|broken) source")
@pytest.mark.parametrize(
    ("names", "correlation_s"), [(40, 30.0), (3_000, 30.0), (1, 1e-3)], ids=str
)
def test_false_poses_do_not_outvote_the_laser(names: int, correlation_s: float) -> None:
    """All report the same pose 4 m off, exact to 0.1 m, and claim to be never wrong."""
    simulation, numbers = Simulation(OFFICE, 0), count(-FROM)
    mcl = ClusterMCL(OFFICE.map, settings=SMALL, seed=0)
    mcl.set_pose(simulation.map_from_robot)

    def lie(tick: Tick) -> None:
        x, y, heading = tick.map_from_robot
        number = next(numbers)
        by_tick = names // FLOOD if names > FLOOD else names
        first = by_tick * number if names > FLOOD else 0
        for name in range(first, first + by_tick if 0 <= number < FLOOD else 0):
            mcl.observe(
                (x + 4.0, y, heading),
                0.01 * np.eye(3),
                stamp_ns=tick.laser.stamp_ns,
                source=f"name {name}",
                outlier_probability=1e-6,
                correlation_s=correlation_s,
            )

    assert all(is_right(*step) for step in driven(mcl, islice(simulation, 110), lie))


@pytest.mark.parametrize("seed", range(3))
def test_one_word_decides_between_four_equal_arms(seed: int) -> None:
    ticks = enumerate(tick.map_from_robot[:2] for tick in Simulation(CROSS, seed))
    word, at = next(
        (n, np.array(at) - CENTRE) for n, at in ticks if n > 80 and max(map(abs, at)) > 2
    )
    axis = np.abs(at).argmax()
    arm = np.zeros(2)
    arm[axis] = np.copysign(REACH_M + 1.0, at[axis])
    square = CENTRE + arm - REACH_M, 2.0 * REACH_M  # from 1 m off the centre on
    mcl, simulation = ClusterMCL(CROSS.map, settings=SMALL, seed=seed), Simulation(CROSS, seed)
    before = driven(mcl, islice(simulation, word))
    assert "localized" not in {belief.state for belief, _ in before}
    corner, side_m = square
    mcl.observe(corner, 1e-6 * np.eye(2), field=[[0.0]], cell_m=side_m, source="person")
    after = list(driven(mcl, islice(simulation, 60)))
    assert len(after) > 1
    assert all(belief.state == "localized" and is_right(belief, tick) for belief, tick in after)
