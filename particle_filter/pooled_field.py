"""The best that a likelihood field gives anywhere in a square: a bound on scans from many poses.

From all positions in a square block of the map, with one heading, a beam ends somewhere in a
square of the same size. The highest value of the field in that square is at least what the beam
gets from any of the positions; the sum over a scan's beams bounds the scan (Hess et al., "Real-time
loop closure in 2D lidar SLAM", 2016, eq. 16). Blocks lie side by side and beams end at any offset
from them, so the squares are kept once for every offset within a block: together as many numbers
as the map has cells. Squares of one offset lie in memory as their blocks do in the map: a beam is
scored for a row of blocks by adding one row of numbers to another.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Cells
from particle_filter.kernel_arguments import read_only
from particle_filter.kernels import kernel
from particle_filter.likelihood_field import LikelihoodField, code_scale
from particle_filter.settings import SensorSettings

LEAF_M = 0.2
"""Side of a leaf [m], rounded to whole cells; blocks are of two by two leaves."""

_CODES_PER_STEP = 257
"""Codes of 16 bits to a step of 8 bits: 65,535 is 255 steps."""
_STRIP_BLOCKS = 64
MOST_BEAMS = 65_535 // 255
"""More beams could overflow the 16-bit sums of their steps."""


def block_cells(cell_m: float) -> int:
    """Side of a block [cells]."""
    return 2 * max(1, round(LEAF_M / cell_m))


@dataclass(frozen=True, eq=False)
class PooledField:
    """Upper bounds of a likelihood field over squares."""

    steps: NDArray[np.uint8]
    """(side, side, rows + 1, cols + 1): [i, j, r + 1, c + 1] is the highest of the square of
    side + 1 cells whose low corner is cell (r side + i, c side + j), in steps above the floor."""
    log_floor: float
    """Log-likelihood of step 0."""
    log_step: float
    """From one step to the next."""

    @property
    def side(self) -> int:
        """Of a block [cells]."""
        return len(self.steps)

    @classmethod
    def build(cls, field: LikelihoodField) -> "PooledField":
        """Pool a field; takes about a second for 16 million cells."""
        side = block_cells(field.cell_m)
        rows, cols = (-(-size // side) for size in field.cells.shape)
        steps = np.zeros((side, side, rows + 1, cols + 1), np.uint8)
        for first in range(0, rows + 1, _STRIP_BLOCKS):
            stop = min(first + _STRIP_BLOCKS, rows + 1)
            # Row 0 of the squares begins one block before the map.
            levels = _levels(field, (first - 1) * side, (stop - 1) * side, cols, side)
            best = _highest_ahead(_highest_ahead(levels, side + 1).T, side + 1).T
            blocks = best.reshape(stop - first, side, cols + 1, side)
            steps[:, :, first:stop] = blocks.transpose(1, 3, 0, 2)
        return cls(steps, field.log_floor, field.log_step * _CODES_PER_STEP)

    @classmethod
    def from_steps(
        cls, steps: NDArray[Any], cells: Cells, cell_m: float, settings: SensorSettings
    ) -> "PooledField":
        """From the steps that `build` made of the field of the same map and settings.

        Raises:
            ValueError: it is of another type or of another map.
        """
        side = block_cells(cell_m)
        expected = (side, side, *(-(-size // side) + 1 for size in cells.shape))
        if steps.dtype != np.uint8 or steps.shape != expected:
            problem = f"steps are {steps.dtype} of {steps.shape}, expected uint8 of {expected}"
            raise ValueError(problem)
        log_floor, log_step = code_scale(settings)
        return cls(steps, log_floor, log_step * _CODES_PER_STEP)

    def bounds(
        self, offsets: NDArray[np.int64], runs: NDArray[np.int64], out: NDArray[np.uint16]
    ) -> None:
        """Bound a scan with one heading for many blocks.

        Args:
            offsets: (B, 2) rows and columns [cells] from a position to the ends of the beams,
                rounded down; at most `MOST_BEAMS`.
            runs: (R, 3) row, first column and number of blocks side by side.
            out: (sum of numbers,) gets the sums of steps, run after run.
        """
        _sum_steps(read_only(self.steps), offsets, runs, out)


def _levels(
    field: LikelihoodField, first: int, stop: int, cols: int, side: int
) -> NDArray[np.uint8]:
    """Steps, rounded up, of cells from row `first` to `stop` and a square's reach beyond."""
    rows = field.cells.shape[0]
    levels = np.zeros((stop - first + side, (cols + 2) * side), np.uint8)
    low, high = max(first, 0), min(stop + side, rows)
    if low < high:
        codes = field.codes[1 + low : 1 + high, 1:-1].astype(np.uint32)
        rounded = (codes + (_CODES_PER_STEP - 1)) // _CODES_PER_STEP
        levels[low - first : high - first, side : side + codes.shape[1]] = rounded
    return levels


def _highest_ahead(levels: NDArray[np.uint8], reach: int) -> NDArray[np.uint8]:
    """The highest of each row and the `reach` - 1 rows after it; the last `reach` - 1 go."""
    width, best = 1, levels
    while 2 * width <= reach:  # squares twice as wide from two that lie side by side
        best = np.maximum(best[:-width], best[width:])
        width *= 2
    rest = reach - width
    return np.maximum(best[: len(best) - rest], best[rest:])


@kernel
def _sum_steps(
    steps: NDArray[np.uint8],
    offsets: NDArray[np.int64],
    runs: NDArray[np.int64],
    out: NDArray[np.uint16],
) -> None:
    side, rows, cols = steps.shape[0], steps.shape[2], steps.shape[3]
    flat = steps.reshape(-1)
    down, across = offsets[:, 0] // side + 1, offsets[:, 1] // side + 1
    inner = (offsets[:, 0] % side) * side + offsets[:, 1] % side
    start = 0
    for run in range(len(runs)):
        row, first, count = runs[run]
        sums = out[start : start + count]
        start += count
        sums[:] = 0
        for beam in range(len(offsets)):
            at, left = row + down[beam], first + across[beam]
            low, high = max(0, -left), min(count, cols - left)
            if not 0 <= at < rows or low >= high:
                continue  # beyond the map: the floor
            begin = (inner[beam] * rows + at) * cols + left
            found, part = flat[begin + low : begin + high], sums[low:high]
            for i in range(len(found)):  # a row plus a row: vector instructions
                part[i] += found[i]
