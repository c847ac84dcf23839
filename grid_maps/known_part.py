"""Large maps are cut to what is known of them: unknown space around it tells nobody anything."""

from math import ceil

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.arrays import UNKNOWN, Cells
from particle_filter.poses import compose
from protocol.message import PoseTuple

LARGE_CELLS = 2**23
"""Maps of more are cut. Smaller ones stay as their files have them, and so do their digests."""
RIM_M = 5.0
"""Is left around what is known: farther from walls than a likelihood field looks."""
_STRIP_ROWS = 512


def known_part(cells: Cells, cell_m: float, map_from_grid: PoseTuple) -> GridMap:
    """A map of these cells; of a large one the part that is known, with a rim around it.

    Poses in the map mean the same places as before. A site plan of 16,384 x 16,384 cells with one
    building costs what the building costs.

    Raises:
        ValueError: as `GridMap`.
    """
    if cells.ndim != 2 or cells.size <= LARGE_CELLS:
        return GridMap(cells, cell_m, map_from_grid)
    known_rows, known_cols = _known(cells)
    if not known_rows.any() or not cell_m > 0.0:
        return GridMap(cells, cell_m, map_from_grid)  # which says what is wrong
    rim = ceil(RIM_M / cell_m)
    rows, cols = _range(known_rows, rim), _range(known_cols, rim)
    part = cells[rows, cols].copy()
    part.flags.writeable = False
    corner = np.array([cols.start * cell_m, rows.start * cell_m, 0.0])
    x, y, _ = compose(np.array(map_from_grid), corner)
    return GridMap(part, cell_m, (float(x), float(y), map_from_grid[2]))


def _known(cells: Cells) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which rows and which columns hold a cell that is known."""
    rows, cols = np.zeros(cells.shape[0], bool), np.zeros(cells.shape[1], bool)
    for first in range(0, len(cells), _STRIP_ROWS):
        known = cells[first : first + _STRIP_ROWS] != UNKNOWN
        rows[first : first + _STRIP_ROWS] = known.any(axis=1)
        cols |= known.any(axis=0)
    return rows, cols


def _range(known: NDArray[np.bool_], rim: int) -> slice:
    at = np.flatnonzero(known)
    return slice(max(int(at[0]) - rim, 0), min(int(at[-1]) + 1 + rim, len(known)))
