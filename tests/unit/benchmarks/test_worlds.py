"""Worlds are symmetric, or differ from their maps, as specified."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt

from benchmarks.worlds import world
from clustermcl.filter.arrays import FREE, OCCUPIED, Cells
from tests.unit.simulator.test_worlds import unlike_when_turned


def surface(cells: Cells) -> NDArray[np.bool_]:
    return np.asarray((cells == OCCUPIED) & binary_dilation(cells == FREE))


def test_the_map_of_last_year_differs_in_a_tenth_of_the_walls() -> None:
    rebuilt = world("hall_last_year")
    assert rebuilt.start is None
    assert np.array_equal(rebuilt.truth.cells, world("hall").truth.cells)
    now, then = (surface(each.cells) for each in (rebuilt.truth, rebuilt.map))
    for one, other in ((now, then), (then, now)):
        away_m = distance_transform_edt(~other)[one] * rebuilt.map.cell_m
        assert 0.08 < np.mean(away_m > 0.3) < 0.12


def test_the_rectangle_is_symmetric_to_the_last_cell() -> None:
    assert not unlike_when_turned(world("rectangle").map, 2).any()
