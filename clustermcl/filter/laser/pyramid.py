"""Upper bounds of the likelihood field over squares, from coarse to fine (a pyramid).

From all positions in a square tile of the map, with one heading, a beam ends in a square as large
as the tile. The maximum of the field in this square bounds the beam's score; the sum over beams
bounds the scan's score (Hess et al., "Real-time loop closure in 2D lidar SLAM", 2016, eq. 16).
On the finest level tiles are leaves, and a leaf has the score at its centre.

Beams end at any offset from a tile, so a level has one square, and one maximum, for each cell of
the map. Squares with the same offset from their tiles are neighbours in memory. So a beam is scored
for a row of tiles by adding two rows of numbers, in a tenth of the time that look-ups take.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import checked, kernel
from clustermcl.filter.laser.likelihood_field import LikelihoodField, code_scale
from clustermcl.filter.settings import SensorSettings

LEAF_M = 0.2
"""Side of a leaf [m], rounded to whole cells."""
LEVELS = 3
"""Number of levels. Tiles of the first have 4 x 4 leaves; each further level halves the width."""
MOST_BEAMS = 65_535 // 255
"""Largest number of beams; more could overflow the 16-bit sums."""

_CODES_PER_STEP = 257
"""Number of 16-bit codes of the field for each 8-bit code of the pyramid (65,535 / 255)."""
_STRIP_TILES = 64
_RUNS_TOGETHER = 64
"""Number of rows scored together: they are neighbours in memory, so most are in the cache."""

Runs = NDArray[np.int64]
"""(R, 3) row, first column and number of tiles side by side."""
Sums = NDArray[np.uint16]
"""(T,) sums of steps, one for each tile, run after run."""


Level = NDArray[np.uint8]
"""(side, side, rows + 1, cols + 1) maxima of the field over squares of `side` cells, in steps above
the floor, read-only; [i, j, r + 1, c + 1] is of the square whose low corner is cell (r side + i,
c side + j)."""


@dataclass(frozen=True, eq=False)
class Pyramid:
    """The levels of a map, coarse to fine."""

    levels: tuple[Level, ...]
    log_floor: float
    """Log-likelihood of step 0."""
    log_step: float
    """Difference in log-likelihood between two steps."""

    @property
    def leaf_cells(self) -> int:
        """Side of a leaf [cells]."""
        return len(self.levels[-1])

    @classmethod
    def arrays_of(cls, field: LikelihoodField) -> dict[str, NDArray[np.uint8]]:
        """Compute the arrays of all levels; for 16 million cells this takes seconds."""
        sides = _sides(field.grid.cell_m)
        arrays = {f"pyramid{i}": _pooled(field, side, side + 1, 0) for i, side in enumerate(sides)}
        leaf = sides[-1]
        return arrays | {f"pyramid{len(sides) - 1}": _pooled(field, leaf, 1, leaf // 2)}

    @classmethod
    def from_arrays(
        cls, arrays: Mapping[str, NDArray[Any]], grid: Grid, settings: SensorSettings
    ) -> "Pyramid":
        """Build a pyramid from the result of `arrays_of` for the same map and settings.

        Raises:
            KeyError, ValueError: an array is missing, or is of another map.
        """
        levels = []
        for i, side in enumerate(_sides(grid.cell_m)):
            rows, cols = _tiles(grid.cells, side)
            shape = (side, side, rows + 1, cols + 1)
            levels.append(checked(arrays[f"pyramid{i}"], np.uint8, shape))
        log_floor, log_step = code_scale(settings)
        return cls(tuple(levels), log_floor, log_step * _CODES_PER_STEP)


def _sides(cell_m: float) -> list[int]:
    """Return the side of a tile at each level [cells]."""
    leaf = max(1, round(LEAF_M / cell_m))
    return [leaf * 2**finer for finer in reversed(range(LEVELS))]


def _tiles(cells: Cells, side: int) -> tuple[int, int]:
    """Return the number of rows and columns of tiles."""
    return tuple(-(-size // side) for size in cells.shape)


def _pooled(field: LikelihoodField, side: int, reach: int, ahead: int) -> Level:
    """Return a `Level`: maxima over squares of `reach` cells, `ahead` cells off each cell."""
    rows, cols = _tiles(field.grid.cells, side)
    steps = np.zeros((side, side, rows + 1, cols + 1), np.uint8)
    for first in range(0, rows + 1, _STRIP_TILES):
        stop = min(first + _STRIP_TILES, rows + 1)
        # Row 0 of the squares begins one tile before the map.
        begin, end = (first - 1) * side + ahead, (stop - 1) * side + ahead
        levels = _levels(
            field, (begin, end + reach - 1), (ahead - side, cols * side + ahead + reach - 1)
        )
        best = _highest_ahead(_highest_ahead(levels, reach).T, reach).T
        tiles = best.reshape(stop - first, side, cols + 1, side)
        steps[:, :, first:stop] = tiles.transpose(1, 3, 0, 2)
    return steps


def _levels(
    field: LikelihoodField, rows: tuple[int, int], cols: tuple[int, int]
) -> NDArray[np.uint8]:
    """Return the steps, rounded up, of ranges of cells; 0 beyond the map."""
    levels = np.zeros((rows[1] - rows[0], cols[1] - cols[0]), np.uint8)
    inner = [
        slice(max(first, 0), min(stop, size))
        for (first, stop), size in zip((rows, cols), field.grid.cells.shape, strict=True)
    ]
    codes = field.codes[1:-1, 1:-1][inner[0], inner[1]].astype(np.uint32)
    if codes.size:
        low, left = inner[0].start - rows[0], inner[1].start - cols[0]
        rounded = (codes + (_CODES_PER_STEP - 1)) // _CODES_PER_STEP
        levels[low : low + codes.shape[0], left : left + codes.shape[1]] = rounded
    return levels


def _highest_ahead(levels: NDArray[np.uint8], reach: int) -> NDArray[np.uint8]:
    """Return the maxima over each row and the `reach` - 1 rows after it."""
    width, best = 1, levels
    while 2 * width <= reach:  # two neighbours make a square of twice the width
        best = np.maximum(best[:-width], best[width:])
        width *= 2
    rest = reach - width
    return np.maximum(best[: len(best) - rest], best[rest:])


@kernel
def sum_steps(steps: Level, offsets: NDArray[np.int64], runs: Runs) -> Sums:
    """Bound the score of a scan with one heading from above, for many tiles.

    The (B, 2) offsets are rows and columns [cells] from a position to the ends of the beams,
    rounded down; at most `MOST_BEAMS`.
    """
    side, rows, cols = steps.shape[0], steps.shape[2], steps.shape[3]
    flat = steps.reshape(-1)
    down, across = offsets[:, 0] // side + 1, offsets[:, 1] // side + 1
    inner = (offsets[:, 0] % side) * side + offsets[:, 1] % side
    from_tile = (inner * rows + down) * cols + across
    starts = np.cumsum(runs[:, 2]) - runs[:, 2]
    sums = np.zeros(runs[:, 2].sum(), np.uint16)
    for batch in range(0, len(runs), _RUNS_TOGETHER):
        for beam in range(0, len(offsets), 4):
            beams = min(4, len(offsets) - beam)
            for run in range(batch, min(batch + _RUNS_TOGETHER, len(runs))):
                row, first, count = runs[run]
                tile, is_whole = row * cols + first, beams == 4
                for k in range(beam, beam + beams):
                    left = first + across[k]
                    is_whole &= 0 <= row + down[k] < rows and 0 <= left <= cols - count
                if is_whole:
                    # Unsigned indices let the loop be compiled to vector instructions. Four beams
                    # together: the sums are read and written a quarter as often.
                    start = np.uint64(starts[run])
                    a, b = np.uint64(from_tile[beam] + tile), np.uint64(from_tile[beam + 1] + tile)
                    c = np.uint64(from_tile[beam + 2] + tile)
                    d = np.uint64(from_tile[beam + 3] + tile)
                    for i in range(np.uint64(count)):
                        sums[start + i] += (
                            np.uint16(flat[a + i]) + np.uint16(flat[b + i])
                            + np.uint16(flat[c + i]) + np.uint16(flat[d + i])
                        )  # fmt: skip
                    continue
                for k in range(beam, beam + beams):
                    left = first + across[k]
                    low, high = max(0, -left), min(count, cols - left)
                    if 0 <= row + down[k] < rows and low < high:  # beyond the map every step is 0
                        begin = np.uint64(from_tile[k] + tile + low)
                        start = np.uint64(starts[run] + low)
                        for i in range(np.uint64(high - low)):
                            sums[start + i] += flat[begin + i]
    return sums
