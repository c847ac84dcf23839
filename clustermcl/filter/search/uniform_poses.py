"""Draws poses spread evenly over the free space of a map."""

import math

import numpy as np

from clustermcl.filter.arrays import FREE, Poses
from clustermcl.filter.grid import Grid

_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0
_CELLS_KEPT = 65_536


class UniformPoses:
    """Draws stratified poses in free space.

    They lie in at most 65,536 free cells, which `rng` chooses.

    Raises:
        ValueError: the map has no free cell.
    """

    def __init__(self, grid: Grid, rng: np.random.Generator) -> None:
        # Row by row, because indices of all free cells could fill the memory.
        counts = np.array([np.count_nonzero(row == FREE) for row in grid.cells])
        ends, total = np.cumsum(counts), int(counts.sum())
        if total == 0:
            raise ValueError("the map has no free cell to look at")
        kept = min(total, _CELLS_KEPT)
        wanted = ((np.arange(kept) + rng.random(kept)) / kept * total).astype(np.int64)
        of_rows = np.split(wanted, np.searchsorted(wanted, ends[:-1]))
        in_rows = zip(grid.cells, of_rows, ends - counts, strict=True)
        self._grid = grid
        self._rows = np.repeat(np.arange(len(counts)), [len(of_row) for of_row in of_rows])
        self._cols = np.concatenate(
            [np.flatnonzero(row == FREE)[of_row - begin] for row, of_row, begin in in_rows]
        )

    def draw(self, count: int, rng: np.random.Generator) -> Poses:
        """Draw (count, 3) poses, one from each stratum of the free cells."""
        x, y, heading = self._grid.map_from_grid.tolist()
        begin, uniform = rng.random(), rng.random((count, 3))
        number, c, s = np.arange(count), math.cos(heading), math.sin(heading)
        chosen = ((number + uniform[:, 0]) / count * len(self._rows)).astype(np.int64)
        chosen = np.minimum(chosen, len(self._rows) - 1)
        along = (self._cols[chosen] + uniform[:, 1]) * self._grid.cell_m
        across = (self._rows[chosen] + uniform[:, 2]) * self._grid.cell_m
        turns = number * _GOLDEN + begin + heading / math.tau
        headings = math.tau * (turns - np.floor(turns)) - math.pi
        return np.column_stack([x + c * along - s * across, y + s * along + c * across, headings])
