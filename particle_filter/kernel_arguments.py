"""Arguments of kernels, one type each: a read-only or strided array would be compiled anew."""

from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose, Poses

ToCells = tuple[float, float, float, float]
"""cos, sin, x and y that carry a point of the map to cells of the grid: see `to_cells`."""


def plain(poses: Poses) -> NDArray[np.float64]:
    """The numbers as C-ordered, aligned, writeable float64; copied only where they are not."""
    if type(poses) is np.ndarray and poses.dtype == np.float64:
        # What `np.require` would do, in a tenth of the time.
        return poses if poses.flags.carray else poses.copy()
    return np.require(poses, np.float64, ["C", "A", "W"])


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A read-only view, whether the array is ours, a peer's or mapped from a file."""
    if type(array) is np.ndarray and array.flags.c_contiguous and not array.flags.writeable:
        return array
    view = np.ascontiguousarray(array).view(np.ndarray)
    view.flags.writeable = False
    return view


def to_cells(map_from_grid: Pose, cell_m: float) -> ToCells:
    """(c, s, x0, y0) such that a point (x, y) of the map lies at column c x - s y + x0 and row
    s x + c y + y0 of the grid, in cells; its cell is the floor of both.
    """
    x, y, heading = (float(value) for value in map_from_grid)
    c, s = cos(heading) / cell_m, sin(heading) / cell_m
    return c, -s, -c * x - s * y, s * x - c * y
