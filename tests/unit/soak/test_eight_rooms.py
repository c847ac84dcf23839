from pathlib import Path

import numpy as np

from particle_filter.arrays import UNKNOWN
from recordings.map_file import load_map
from robot_simulator.simulation import Simulation
from tests.maps import write_map
from tests.soak.eight_rooms import PLACES, copies_in_all_rooms, eight_rooms


def test_the_rooms_are_alike_to_the_last_cell() -> None:
    cells = eight_rooms().map.cells
    columns = np.flatnonzero((cells != UNKNOWN).any(axis=0))
    rows = np.flatnonzero((cells != UNKNOWN).any(axis=1))
    used = cells[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    across, up = 130, 110  # cells from one room to the next: 6.5 m and 5.5 m
    assert (used[:, across:] == used[:, :-across]).all()
    assert (used[up:] == used[:-up]).all()


def test_a_robot_stays_in_its_room() -> None:
    simulation = Simulation(eight_rooms(), seed=1)
    poses = np.array([next(simulation).map_from_robot for _ in range(100)])
    assert np.ptp(poses[:, 0]) < 6.0
    assert np.ptp(poses[:, 1]) < 5.0


def test_a_pose_has_a_copy_in_each_room_and_copies_have_the_same_copies() -> None:
    start = eight_rooms().start
    assert start is not None
    copies = copies_in_all_rooms(start)
    assert len(set(copies)) == PLACES
    assert start in copies
    for copy in copies:
        np.testing.assert_allclose(copies_in_all_rooms(copy), copies, rtol=0, atol=1e-12)


def test_writing_and_reading_a_map_preserves_it(tmp_path: Path) -> None:
    grid_map = eight_rooms().map
    read = load_map(str(write_map(grid_map, tmp_path, "rooms")))
    np.testing.assert_array_equal(read.cells, grid_map.cells)
    assert read.cell_m == grid_map.cell_m
    assert read.map_from_grid == grid_map.map_from_grid
