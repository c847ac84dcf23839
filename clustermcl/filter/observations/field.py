"""Observations of the robot's position as a likelihood in each cell of a coarse grid."""

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, LogWeights, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import ToCells, kernel, to_cells
from clustermcl.filter.observations.kind import Kind, Landmarks

_MOST_SIGMA = 1000.0
"""Larger errors of a field's position [cells] are limited, because of rounding."""
_FIELDS_KEPT = 16
"""Fields of one map whose shares of the free space are kept."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Field(Kind):
    """Log-likelihoods of a measurement in the cells of a grid along the axes of the map.

    `mean` is the (2,) low corner in the map [m]. The likelihood is relative to its average over the
    free space: a field says where on the map the robot is, not whether it is there.
    """

    cell_m: float
    """Side of a cell [m]."""
    log_likelihoods: NDArray[np.float64]
    """(rows, cols), row 0 has the lowest y; a constant added to all has no effect."""
    map_digest: str = ""
    """The map that it was made for; empty: any."""

    def weights(self) -> NDArray[np.float64]:
        """Return the (rows, cols) probabilities of the cells, blurred by the position's error.

        Without an error they sum to one; what an error moves out of the field is missing. The
        correlation of the error is neglected.
        """
        logs = self.log_likelihoods.astype(np.float64)
        likelihoods = np.exp(logs - logs.max())
        x, y = (math.sqrt(variance) / self.cell_m for variance in np.diag(self.covariance))
        rows, cols = likelihoods.shape
        blurred = _blur(rows, y) @ likelihoods @ _blur(cols, x)
        return np.asarray(blurred / likelihoods.sum())

    def free_shares(self, grid: Grid) -> NDArray[np.float64]:
        """Return (rows, cols) shares of the map's free space in the field's cells."""
        shape = self.log_likelihoods.shape
        key = (*self.mean.tolist(), self.cell_m, *shape)
        kept = grid.once("free shares of fields", dict[Hashable, NDArray[np.float64]])
        shares = kept.get(key)
        if shares is None:
            if len(kept) >= _FIELDS_KEPT:
                kept.clear()
            to_field = to_cells(np.append(self.mean, 0.0), self.cell_m)
            in_map = (*grid.map_from_grid.tolist(), grid.cell_m)
            kept[key] = shares = _free_shares(grid.cells, in_map, to_field, shape)
        return shares

    def ratios(self, free: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Return the likelihood ratios of the cells, and that of poses outside of the field.

        Weight that is missing, or in cells without free space, is that of outliers. `free` are the
        (rows, cols) free areas of the cells, relative to that of the map; None: the field is the
        map, and all of it is free.

        Returns:
            (rows x cols + 1,), positive; the last is that outside.
        """
        weights = self.weights()
        free = np.full_like(weights, 1.0 / weights.size) if free is None else free
        usable = np.where(free > 0.0, weights, 0.0)
        average = float((usable * free).sum())
        if average <= 0.0:
            return np.ones(weights.size + 1)
        right = (1.0 - self.outlier_probability) * min(usable.sum(), 1.0)
        found: NDArray[np.float64] = 1.0 - right + right * np.append(usable / average, 0.0)
        return found

    def _cells_at(self, poses: Poses) -> NDArray[np.int64]:
        """Return the index of the cell of each (N, 3) pose; -1: it is outside."""
        rows, cols = self.log_likelihoods.shape
        col, row = np.floor((poses[:, :2] - self.mean) / self.cell_m).T
        inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
        return np.where(inside, row * cols + col, -1).astype(np.int64)

    def arrays(self, landmarks: Landmarks, grid: Grid) -> Mapping[str, NDArray[Any]]:
        return {
            "fields": np.array([[*self.mean, 1.0 / self.cell_m, self.share]]),
            "field_cells": np.array([self.log_likelihoods.shape], np.int64),
            "field_ratios": np.log(self.ratios(self.free_shares(grid))),
        }

    def log_average_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        return 0.0

    def largest_log_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        return math.log(self.ratios().max())

    def outlier_probability_at(self, pose: Pose, landmarks: Landmarks, grid: Grid) -> float:
        """Return it relative to the average over the field's cells."""
        return float(self.outlier_probability / self.ratios()[self._cells_at(pose[None])[0]])

    def _free_weights(self, grid: Grid) -> NDArray[np.float64]:
        """Return (rows, cols) weights of the cells with free space."""
        return np.where(self.free_shares(grid) > 0.0, self.weights(), 0.0)

    def draw(self, landmarks: Landmarks, grid: Grid, count: int, rng: np.random.Generator) -> Poses:
        weights = self._free_weights(grid)
        if not weights.any():
            return np.zeros((0, 3))
        chosen = rng.choice(weights.size, count, p=weights.ravel() / weights.sum())
        rows, cols = np.divmod(chosen, weights.shape[1])
        poses = rng.uniform(-math.pi, math.pi, (count, 3))
        corners = self.mean + np.column_stack([cols, rows]) * self.cell_m
        poses[:, :2] = corners + rng.random((count, 2)) * self.cell_m
        return poses

    def density(
        self, poses: Poses, excess: LogWeights, landmarks: Landmarks, grid: Grid
    ) -> NDArray[np.float64]:
        weights = self._free_weights(grid)
        shares = weights.ravel()[self._cells_at(poses)] / weights.sum()
        return np.asarray(shares * grid.free_m2 / self.cell_m**2)

    def informativeness(self, landmarks: Landmarks, grid: Grid) -> float:
        """Return the area that it allows, negative, so that the smallest is the largest."""
        return -(self.cell_m**2) / float(self.weights().max())


@kernel
def _free_shares(
    cells: NDArray[np.int8],
    in_map: tuple[float, float, float, float],
    to_field: ToCells,
    shape: tuple[int, int],
) -> NDArray[np.float64]:
    shares, total = np.zeros(shape), 0
    x0, y0, heading, cell_m = in_map
    cos, sin, (per_m, _, col0, row0) = math.cos(heading), math.sin(heading), to_field
    for row in range(cells.shape[0]):
        across = (row + 0.5) * cell_m
        for col in range(cells.shape[1]):
            if cells[row, col] != FREE:
                continue
            total += 1
            along = (col + 0.5) * cell_m
            field_col = (x0 + cos * along - sin * across) * per_m + col0
            field_row = (y0 + sin * along + cos * across) * per_m + row0
            if 0.0 <= field_col < shape[1] and 0.0 <= field_row < shape[0]:
                shares[int(field_row), int(field_col)] += 1.0
    return shares / max(total, 1)


def _blur(count: int, sigma: float) -> NDArray[np.float64]:
    """Return the symmetric (count, count) parts of a cell's weight that an error moves to others.

    `sigma` is the standard deviation of the error [cells].
    """
    sigma = min(sigma, _MOST_SIGMA)
    # A normal density, integrated twice: the second difference is for weight all over a cell.
    apart = np.arange(-1, count + 1)
    below = np.array([0.5 + 0.5 * math.erf(cells / (sigma * math.sqrt(2.0))) for cells in apart])
    integral = apart * below + sigma / math.sqrt(math.tau) * np.exp(-0.5 * (apart / sigma) ** 2)
    parts = np.maximum(np.diff(integral, 2), 0.0)
    return np.asarray(parts[np.abs(np.subtract.outer(np.arange(count), np.arange(count)))])
