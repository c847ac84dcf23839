"""Observations of the robot's position as a likelihood in each cell of a coarse grid."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_MOST_SIGMA = 1000.0
"""Larger errors of a field's position [cells] are limited, because of rounding."""


@dataclass(frozen=True, eq=False)
class PositionField:
    """Log-likelihoods of a measurement in the cells of a grid along the axes of the map."""

    cell_m: float
    """Side of a cell [m]."""
    log_likelihoods: NDArray[np.float64]
    """(rows, cols), row 0 has the lowest y; a constant added to all has no effect."""

    def weights(self, covariance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (rows, cols) probabilities of the cells, if the field's position has an error.

        Without an error they sum to one; what an error moves out of the field is missing.

        Args:
            covariance: (2, 2) of the position; its correlation is neglected.
        """
        logs = self.log_likelihoods.astype(np.float64)
        likelihoods = np.exp(logs - logs.max())
        x, y = (math.sqrt(variance) / self.cell_m for variance in np.diag(covariance))
        rows, cols = likelihoods.shape
        blurred = _blur(rows, y) @ likelihoods @ _blur(cols, x)
        return np.asarray(blurred / likelihoods.sum())


def ratios(
    weights: NDArray[np.float64], free: NDArray[np.float64], outlier_probability: float
) -> NDArray[np.float64]:
    """Return the likelihood ratios of a field's cells, and that of poses outside of it.

    The likelihood is relative to its average over the free space: a field says where on the map
    the robot is, not whether it is there. Weight that is missing, or in cells without free space,
    is that of outliers.

    Args:
        weights: (rows, cols) probabilities of the cells; their sum is at most one.
        free: (rows, cols) free areas of the cells, relative to that of the map.
        outlier_probability: that the field is false.

    Returns:
        (rows x cols + 1,), positive; the last is that outside.
    """
    usable = np.where(free > 0.0, weights, 0.0)
    average = float((usable * free).sum())
    if average <= 0.0:
        return np.ones(weights.size + 1)
    right = (1.0 - outlier_probability) * min(usable.sum(), 1.0)
    found: NDArray[np.float64] = 1.0 - right + right * np.append(usable / average, 0.0)
    return found


def _blur(count: int, sigma: float) -> NDArray[np.float64]:
    """Return the symmetric (count, count) parts of a cell's weight that an error moves to others.

    Args:
        count: number of cells in a line.
        sigma: standard deviation of the error [cells].
    """
    sigma = min(sigma, _MOST_SIGMA)
    # A normal density, integrated twice: the second difference is for weight all over a cell.
    apart = np.arange(-1, count + 1)
    below = np.array([0.5 + 0.5 * math.erf(cells / (sigma * math.sqrt(2.0))) for cells in apart])
    integral = apart * below + sigma / math.sqrt(math.tau) * np.exp(-0.5 * (apart / sigma) ** 2)
    parts = np.maximum(np.diff(integral, 2), 0.0)
    return np.asarray(parts[np.abs(np.subtract.outer(np.arange(count), np.arange(count)))])
