import numpy as np
import pytest

from clustermcl.evaluation.map_check.report import ground_of
from clustermcl.recordings.maps.grid_map import GridMap


def test_pieces_and_the_open_rim_of_the_ground_are_measured() -> None:
    cells = np.full((10, 30), 1, np.int8)
    cells[2:8, 2:12] = 0  # 60 cells, walled in
    cells[2:8, 15:17] = 0  # 12 cells next to them
    cells[3:5, 17] = -1  # with a window of two cells
    cells[0, 29] = 0  # a speck, on the rim of the map
    ground = ground_of(GridMap(cells, 0.5, (0.0, 0.0, 0.0)))
    assert (ground.rows, ground.cols, ground.width_m, ground.height_m) == (10, 30, 15.0, 5.0)
    assert ground.free_m2 == pytest.approx(73 * 0.25)
    assert ground.pieces == 2
    assert ground.largest_piece_share == pytest.approx(60 / 73)
    around = 2 * (6 + 10) + 2 * (6 + 2) + 4  # of the rooms, and of the speck
    assert ground.open_rim_share == pytest.approx((2 + 2) / around)  # off the map is unknown
    assert ground.unknown_share == pytest.approx(2 / 300)
