from itertools import islice, pairwise

import numpy as np
import pytest

from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN
from robot_simulator.free_space import FreeSpace
from robot_simulator.simulation import Simulation, Tick
from robot_simulator.worlds.catalogue import WORLDS, world
from robot_simulator.worlds.world import UnknownWorldError, World, world_from_map
from tests.unit.robot_simulator.looks import beams_that_touch, unlike_when_turned


def driven_m(ticks: list[Tick]) -> float:
    poses = [tick.map_from_robot for tick in ticks]
    return float(sum(np.hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(poses)))


def ticks_until_feature(somewhere: World, times: int) -> list[Tick]:
    """What the robot does before any ray around it touches what breaks the symmetry."""
    ticks = list(islice(Simulation(somewhere, seed=0), 1300))
    unlike = unlike_when_turned(somewhere.map, times)
    poses = [tick.map_from_robot for tick in ticks]
    touching = beams_that_touch(somewhere.map, unlike, poses, somewhere.lidar_range_m)
    assert touching.max() > 150  # of 1,440: in the end it is seen well
    return ticks[: int(np.argmax(touching > 0))]


@pytest.mark.parametrize("name", WORLDS)
def test_every_world_is_walled_in_and_has_room_for_the_robot(name: str) -> None:
    somewhere = world(name)
    cells = somewhere.truth.cells
    assert set(np.unique(cells)) == {FREE, OCCUPIED, UNKNOWN}
    for axis in (0, 1):  # every way out crosses a wall
        ahead = np.roll(cells, 1, axis)
        assert not np.any((cells == FREE) & (ahead == UNKNOWN))
        assert not np.any((cells == UNKNOWN) & (ahead == FREE))
    FreeSpace(somewhere.truth)


@pytest.mark.parametrize(("name", "times"), [("cross", 4), ("rectangle", 2), ("hall_symmetric", 2)])
def test_symmetric_worlds_are_symmetric_to_the_last_cell(name: str, times: int) -> None:
    assert not unlike_when_turned(world(name).map, times).any()


def test_the_cross_differs_from_its_turned_self_by_one_cabinet() -> None:
    plain, unlike = world("cross").map.cells, world("cross_feature").map.cells
    rows, cols = np.nonzero(plain != unlike)
    cabinet_m2 = 1.4 * 1.0
    assert len(rows) == (np.ptp(rows) + 1) * (np.ptp(cols) + 1)
    assert len(rows) * 0.05**2 == pytest.approx(cabinet_m2)


def test_the_gates_room_differs_from_its_turned_self_by_one_cabinet_each_way() -> None:
    unlike = unlike_when_turned(world("gates").map, 2)
    cabinet_m2 = 1.3 * 0.7
    assert np.count_nonzero(unlike) * 0.05**2 == pytest.approx(2 * cabinet_m2)


def test_the_arms_of_the_cross_differ_only_after_a_long_drive() -> None:
    before = ticks_until_feature(world("cross_feature"), 4)
    assert 25.0 < driven_m(before) < 35.0


def test_the_hall_looks_different_from_its_turned_self_almost_everywhere() -> None:
    unlike = unlike_when_turned(world("hall").map, 2)
    assert np.count_nonzero(unlike) * 0.05**2 > 10.0  # m2


def test_an_unknown_world_is_refused_with_all_that_are_known() -> None:
    with pytest.raises(UnknownWorldError, match=r"'moon'; known are cross, .*hall_symmetric"):
        world("moon")


def test_a_map_makes_a_world_that_equals_it() -> None:
    grid_map = GridMap(np.zeros((40, 40), np.int8), 0.1, (1.0, 2.0, 0.5))
    somewhere = world_from_map(grid_map)
    assert somewhere.map is somewhere.truth is grid_map
    assert (somewhere.start, somewhere.route) == (None, ())
