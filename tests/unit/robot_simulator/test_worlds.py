"""Worlds look as they should: symmetric to the last cell, or different where specified."""

from itertools import islice, pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt

from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from robot_simulator.free_space import FreeSpace
from robot_simulator.robot import RADIUS_M
from robot_simulator.simulation import Simulation, Tick
from robot_simulator.worlds.catalogue import world, world_names
from robot_simulator.worlds.world import Canvas, UnknownWorldError, World, world_from_map
from tests.unit.robot_simulator.looks import beams_that_touch, unlike_when_turned


def driven_m(ticks: list[Tick]) -> float:
    poses = [tick.map_from_robot for tick in ticks]
    return float(sum(np.hypot(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(poses)))


def surface(cells: Cells) -> NDArray[np.bool_]:
    return np.asarray((cells == OCCUPIED) & binary_dilation(cells == FREE))


def ticks_until_feature(somewhere: World, times: int) -> list[Tick]:
    """What the robot does before any ray around it touches what breaks the symmetry."""
    ticks = list(islice(Simulation(somewhere, seed=0), 1300))
    unlike = unlike_when_turned(somewhere.map, times)
    poses = [tick.map_from_robot for tick in ticks]
    touching = beams_that_touch(somewhere.map, unlike, poses, somewhere.lidar_range_m)
    assert touching.max() > 150  # of 1,440: in the end it is seen well
    return ticks[: int(np.argmax(touching > 0))]


@pytest.mark.parametrize("name", world_names())
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


def test_a_rectangle_is_not_four_fold_symmetric() -> None:
    rows, cols = world("rectangle").map.cells.shape
    assert rows != cols


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


def test_the_missing_cabinet_is_seen_only_on_the_last_legs() -> None:
    room = world("gates")
    before = ticks_until_feature(room, 2)
    legs = np.diff(np.array([room.start[:2] if room.start else (), *room.route]), axis=0)
    assert driven_m(before) > np.hypot(*legs[:-2].T).sum() - 2.0  # corners are cut


@pytest.mark.parametrize("name", [name for name in world_names() if world(name).route])
def test_routes_keep_clear_of_everything(name: str) -> None:
    somewhere = world(name)
    assert somewhere.start is not None
    free_space = FreeSpace(somewhere.truth)
    for a, b in pairwise([somewhere.start[:2], *somewhere.route]):
        for share in np.linspace(0.0, 1.0, 100):
            x, y = (1.0 - share) * np.array(a) + share * np.array(b)
            assert free_space.clearance_m(x, y) > RADIUS_M + 0.1, (a, b)


def test_the_office_is_large_and_mostly_alike() -> None:
    office = world("office").map
    assert office.free_area_m2 > 5_000.0
    a_room_on = np.roll(office.cells, 100, axis=1)[:, 200:-200]  # 5 m: from one door to the next
    alike = np.mean(a_room_on == office.cells[:, 200:-200])
    assert 0.9 < alike < 0.995


@pytest.mark.parametrize("name", ["hall", "hall_symmetric", "hall_moved", "hall_last_year"])
def test_halls_are_of_one_size(name: str) -> None:
    assert world(name).map.free_area_m2 == pytest.approx(450.0, rel=0.05)


def test_the_hall_looks_different_from_its_turned_self_almost_everywhere() -> None:
    unlike = unlike_when_turned(world("hall").map, 2)
    assert np.count_nonzero(unlike) * 0.05**2 > 10.0  # m2


def test_furniture_was_moved_only_round_the_start() -> None:
    hall = world("hall_moved")
    assert hall.start is not None
    rows, cols = np.nonzero(hall.map.cells != hall.truth.cells)
    x = hall.map.map_from_grid[0] + (cols + 0.5) * hall.map.cell_m
    y = hall.map.map_from_grid[1] + (rows + 0.5) * hall.map.cell_m
    assert 0 < np.hypot(x - hall.start[0], y - hall.start[1]).max() < 7.0


def test_since_last_year_a_tenth_of_the_walls_was_moved() -> None:
    rebuilt = world("hall_last_year")
    assert rebuilt.start is None
    assert np.array_equal(rebuilt.truth.cells, world("hall").truth.cells)
    now, then = (surface(each.cells) for each in (rebuilt.truth, rebuilt.map))
    for one, other in ((now, then), (then, now)):
        away_m = distance_transform_edt(~other)[one] * rebuilt.map.cell_m
        assert 0.08 < np.mean(away_m > 0.3) < 0.12


def test_an_unknown_world_is_refused_with_all_that_are_known() -> None:
    with pytest.raises(UnknownWorldError, match=r"'moon'; known are cross, .*hall_moved"):
        world("moon")


def test_a_map_makes_a_world_that_equals_it() -> None:
    grid_map = GridMap(np.zeros((40, 40), np.int8), 0.1, (1.0, 2.0, 0.5))
    somewhere = world_from_map(grid_map)
    assert somewhere.map is somewhere.truth is grid_map
    assert (somewhere.start, somewhere.route) == (None, ())


def test_drawing_off_the_canvas_is_refused() -> None:
    with pytest.raises(ValueError, match="canvas"):
        Canvas(4.0, 4.0).floor(-1.0, 0.0, 2.5, 1.0)
