"""The likelihood field, which scores how near the ends of beams are to obstacles of the map."""

from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import OCCUPIED, Cells, LogField, LogWeights, Points, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import checked, kernel, plain
from clustermcl.filter.kernels.elementary_functions import cos_sin
from clustermcl.filter.settings import SensorSettings

Codes = NDArray[np.uint16]
_MAX_CODE = 65_535
_MAX_BEAMS = 65_536
"""More beams could overflow the 32-bit sum of their codes."""
_STRIP_ROWS = 512
_BLOCK = 256
"""Particles scored together: their numbers stay in the nearest cache."""


def _log_field(cells: Cells, cell_m: float, settings: SensorSettings) -> LogField:
    """Return the log-likelihood of a hit in each cell (table 6.3, lines 6 and 7)."""
    from scipy.ndimage import distance_transform_edt  # noqa: PLC0415 - 16 MB, not with a cached map

    blocked, most_m = cells == OCCUPIED, np.float32(settings.max_obstacle_distance_m)
    if blocked.any():
        distance_m = distance_transform_edt(~blocked).astype(np.float32) * np.float32(cell_m)
        distance_m = np.minimum(distance_m, most_m)
    else:
        distance_m = np.full(cells.shape, most_m)
    likelihood = np.exp(-0.5 * (distance_m / np.float32(settings.hit_sigma_m)) ** 2)
    likelihood *= np.float32(peak(settings))
    likelihood += np.float32(settings.random_weight / settings.max_range_m)
    return np.asarray(np.log(likelihood), np.float32)


@dataclass(frozen=True, eq=False)
class LikelihoodField:
    """A map prepared for scoring scans.

    Log-likelihoods are 16-bit codes, half the memory of floats. A code errs by `log_step` / 2 at
    most, about 4e-5 nat, and sums of codes are exact in any order. The arrays are read-only, so
    several processes can map them from one file.
    """

    codes: Codes
    """(rows + 2, cols + 2); the rim around the map has code 0."""
    grid: Grid
    log_floor: float
    """Log-likelihood of code 0: a beam that ends far from all obstacles."""
    log_step: float
    """Difference in log-likelihood between two codes."""

    @classmethod
    def build(cls, grid: Grid, settings: SensorSettings) -> "LikelihoodField":
        """Compute the field of a map: the log-likelihood of a beam that ends in each cell.

        log(hit_weight * N(d; 0, hit_sigma_m) + random_weight / max_range_m) [1/m], where d is the
        distance to the nearest occupied cell, capped at `max_obstacle_distance_m`. It is a
        density, so logarithms of beams add. Unknown cells are treated as free.

        Raises:
            ValueError: no cell is occupied; every pose would fit equally well.

        References:
            Probabilistic Robotics (2005), table 6.3, lines 6 and 7, in logarithms.
        """
        cells, cell_m = grid.cells, grid.cell_m
        if not np.any(cells == OCCUPIED):
            raise ValueError("the map has no occupied cell to compare a scan with")
        log_floor, step = map(np.float32, code_scale(settings))
        codes = np.zeros((cells.shape[0] + 2, cells.shape[1] + 2), np.uint16)
        # In strips of rows, as intermediate numbers take 20 bytes a cell. Each strip includes rows
        # of its neighbours as far as obstacles count.
        reach = int(settings.max_obstacle_distance_m / cell_m) + 2
        for start in range(0, len(cells), _STRIP_ROWS):
            first, stop = max(start - reach, 0), min(start + _STRIP_ROWS, len(cells))
            field = _log_field(cells[first : stop + reach], cell_m, settings)
            levels = (field[start - first : stop - first] - log_floor) / step
            codes[start + 1 : stop + 1, 1:-1] = np.clip(np.rint(levels), 0, _MAX_CODE)
        return cls.from_codes(codes, grid, settings)

    @classmethod
    def from_codes(cls, codes: Codes, grid: Grid, settings: SensorSettings) -> "LikelihoodField":
        """Build a field from its codes, for the same map and settings.

        Raises:
            ValueError: the codes are of another type or do not fit the map's size.
        """
        rows, cols = grid.cells.shape
        log_floor, log_step = code_scale(settings)
        return cls(checked(codes, np.uint16, (rows + 2, cols + 2)), grid, log_floor, log_step)


def scan_log_likelihood(
    map_from_robot: Poses, hits_in_robot: Points, field: LikelihoodField
) -> LogWeights:
    """Weigh every particle by how well the scan fits the map from its pose.

    Each beam's end point is carried into the map and reads the field there. Beams are
    taken as independent, so logarithms add. A hit outside the map is far from everything.

    Returns:
        (N,) log-likelihood of (B, 2) hits for each of (N, 3) poses, not normalised.

    Raises:
        ValueError: no beam returned; a sum over nothing would call all poses equally good. Or
            more than 65,536 did.

    References:
        Probabilistic Robotics (2005), table 6.3, in logarithms: 180 densities underflow.
    """
    if not 0 < len(hits_in_robot) <= _MAX_BEAMS:
        raise ValueError(f"a scan of {len(hits_in_robot)} returns cannot be scored")
    grid = field.grid
    return _scored(
        plain(map_from_robot),
        plain(hits_in_robot),
        field.codes,
        (field.log_floor, field.log_step, grid.cell_m, grid.map_from_grid[2], *grid.in_cells),
    )


def code_scale(settings: SensorSettings) -> tuple[float, float]:
    """Return the log-likelihood of code 0 and the step, so that the maximum has code 65,535."""
    log_random, log_peak = log(settings.random_weight / settings.max_range_m), log(peak(settings))
    deviations = settings.max_obstacle_distance_m / settings.hit_sigma_m
    log_floor = float(np.logaddexp(log_random, log_peak - 0.5 * deviations**2))
    span = float(np.logaddexp(log_random, log_peak)) - log_floor
    return log_floor, max(span, 1e-9) / _MAX_CODE  # a field of one value has codes too


def peak(settings: SensorSettings) -> float:
    """Return the density of a hit exactly on an obstacle [1/m]."""
    return settings.hit_weight / (sqrt(2.0 * pi) * settings.hit_sigma_m)


@kernel
def _scored(poses: Poses, hits: Points, codes: Codes, numbers: tuple[float, ...]) -> LogWeights:
    """Sum the codes at every particle's hits, and convert the sums to log-likelihoods.

    Numbers: `log_floor`, `log_step`, `cell_m`, the grid's heading, and the four of `in_cells`.

    The inner loop is over particles: its turns are independent, so it is compiled to vector
    instructions.
    """
    log_floor, log_step, cell_m, heading, c, s, x0, y0 = numbers
    flat, cols = codes.reshape(-1), np.int32(codes.shape[1])
    # Middles of the last cells: rounding cannot push a clamped hit past the table.
    last_x, last_y = np.float32(codes.shape[1] - 0.5), np.float32(codes.shape[0] - 0.5)
    fits, sums = np.empty(len(poses)), np.empty(_BLOCK, np.uint32)
    x, y = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    cos_h, sin_h = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    cells = np.empty(_BLOCK, np.uint32)
    for start in range(0, len(poses), _BLOCK):
        total = sums[: min(_BLOCK, len(poses) - start)]
        total[:] = 0
        for i in range(len(total)):
            at = poses[start + i]
            x[i] = c * at[0] - s * at[1] + x0 + 1.0  # 1: the rim
            y[i] = s * at[0] + c * at[1] + y0 + 1.0
            cos_h[i], sin_h[i] = cos_sin(at[2] - heading)
        for beam in range(len(hits)):
            along, across = np.float32(hits[beam, 0] / cell_m), np.float32(hits[beam, 1] / cell_m)
            for i in range(len(total)):
                col = x[i] + cos_h[i] * along - sin_h[i] * across  # table 6.3, line 5
                row = y[i] + sin_h[i] * along + cos_h[i] * across  # table 6.3, line 6
                # Clamped to the rim before int(): of a far pose, compiled int() is an overflow.
                # In this order a NaN goes to the rim too.
                col = max(np.float32(0.0), min(last_x, col))
                row = max(np.float32(0.0), min(last_y, row))
                cells[i] = np.int32(row) * cols + np.int32(col)
            for i in range(len(total)):
                total[i] += flat[cells[i]]
        for i in range(len(total)):
            fits[start + i] = len(hits) * log_floor + log_step * np.float64(total[i])
    return fits
