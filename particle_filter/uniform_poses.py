"""Draws poses spread evenly over the free space of a map."""

import math

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import FREE, Poses
from particle_filter.grid import Grid
from particle_filter.kernels import kernel

_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_CELLS_KEPT = 65_536
_STRIP_ROWS = 512
"""Number of rows read together, because indices of all free cells could fill the memory."""


class UniformPoses:
    """Draws stratified poses in free space.

    Args:
        grid: the map.
        rng: chooses at most 65,536 free cells, in which all poses lie.

    Raises:
        ValueError: the map has no free cell.
    """

    def __init__(self, grid: Grid, rng: np.random.Generator) -> None:
        self._grid = grid
        self._rows, self._cols = _spread_cells(grid, rng)

    def draw(self, count: int, rng: np.random.Generator) -> Poses:
        """Draw (count, 3) poses, one from each stratum of the free cells."""
        x, y, heading = self._grid.map_from_grid.tolist()
        numbers = self._grid.cell_m, x, y, heading, rng.random()
        return _spread(self._rows, self._cols, rng.random((count, 3)), numbers)


@kernel
def _spread(
    rows: NDArray[np.int64],
    cols: NDArray[np.int64],
    uniform: NDArray[np.float64],
    numbers: tuple[float, ...],
) -> Poses:
    """Return poses; numbers: side of a cell, pose of the grid in the map, first heading [turns]."""
    cell_m, x, y, heading, begin = numbers
    count, c, s = len(uniform), math.cos(heading), math.sin(heading)
    poses = np.empty((count, 3))
    for i in range(count):
        chosen = min(int((i + uniform[i, 0]) / count * len(rows)), len(rows) - 1)
        along = (cols[chosen] + uniform[i, 1]) * cell_m
        across = (rows[chosen] + uniform[i, 2]) * cell_m
        turns = i * _GOLDEN + begin + heading / (2.0 * math.pi)
        poses[i, 0] = x + c * along - s * across
        poses[i, 1] = y + s * along + c * across
        poses[i, 2] = 2.0 * math.pi * (turns - math.floor(turns)) - math.pi
    return poses


def _spread_cells(
    grid: Grid, rng: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return rows and columns of at most 65,536 cells, spread evenly over all free cells."""
    strips = range(0, len(grid.cells), _STRIP_ROWS)
    counts = [
        int(np.count_nonzero(grid.cells[first : first + _STRIP_ROWS] == FREE)) for first in strips
    ]
    total = sum(counts)
    if total == 0:
        raise ValueError("the map has no free cell to look at")
    kept = min(total, _CELLS_KEPT)
    wanted = ((np.arange(kept) + rng.random(kept)) / kept * total).astype(np.int64)
    ends = np.cumsum(counts)
    cells = []
    for first, begin, end in zip(strips, [0, *ends], ends, strict=False):
        inside = wanted[(wanted >= begin) & (wanted < end)] - begin
        if len(inside):
            free = np.flatnonzero(grid.cells[first : first + _STRIP_ROWS] == FREE)
            cells.append(free[inside] + first * grid.cells.shape[1])
    rows, cols = np.divmod(np.concatenate(cells), grid.cells.shape[1])
    return rows, cols
