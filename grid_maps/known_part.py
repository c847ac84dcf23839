"""Crops large maps to their known cells: the unknown border holds no information."""

from math import ceil

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.arrays import UNKNOWN, Cells
from particle_filter.poses import compose
from protocol.message import PoseTuple

LARGE_CELLS = 2**23
"""Larger maps are cropped. Smaller ones, and so their digests, stay unchanged."""
RIM_M = 5.0
"""Margin around the known cells, wider than the range of a likelihood field [m]."""
_STRIP_ROWS = 512


def known_part(cells: Cells, cell_m: float, map_from_grid: PoseTuple) -> GridMap:
    """Return a map of these cells, cropped to the known part and a margin if it is large.

    Poses keep their meaning. A site plan of 16,384 x 16,384 cells with one building costs as much
    as a map of the building.

    Raises:
        ValueError: as `GridMap`.
    """
    if cells.ndim != 2 or cells.size <= LARGE_CELLS:
        return GridMap(cells, cell_m, map_from_grid)
    known_rows, known_cols = _known(cells)
    if not known_rows.any() or not cell_m > 0.0:
        return GridMap(cells, cell_m, map_from_grid)  # raises the error
    rim = ceil(RIM_M / cell_m)
    rows, cols = _range(known_rows, rim), _range(known_cols, rim)
    part = cells[rows, cols].copy()
    part.flags.writeable = False
    corner = np.array([cols.start * cell_m, rows.start * cell_m, 0.0])
    x, y, _ = compose(np.array(map_from_grid), corner)
    return GridMap(part, cell_m, (float(x), float(y), map_from_grid[2]))


def _known(cells: Cells) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which rows and which columns have a known cell."""
    rows, cols = np.zeros(cells.shape[0], bool), np.zeros(cells.shape[1], bool)
    for first in range(0, len(cells), _STRIP_ROWS):
        known = cells[first : first + _STRIP_ROWS] != UNKNOWN
        rows[first : first + _STRIP_ROWS] = known.any(axis=1)
        cols |= known.any(axis=0)
    return rows, cols


def _range(known: NDArray[np.bool_], rim: int) -> slice:
    at = np.flatnonzero(known)
    return slice(max(int(at[0]) - rim, 0), min(int(at[-1]) + 1 + rim, len(known)))
