"""Observations of the robot's pose or position in the map, as of GNSS or another localizer."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.kind import Kind, Landmarks, density
from clustermcl.filter.poses import compose, wrap_angle


@dataclass(frozen=True, eq=False)
class PositionFix(Kind):
    """The (2,) position of the robot in the map [m], as from a receiver of satellites."""

    _headings: ClassVar[float] = 1.0
    """Range over which false headings are spread [rad]; 1: no heading is observed."""

    def _right(self, grid: Grid) -> float:
        """Return the factor of the Gaussian density in the likelihood ratio."""
        return self.odds * (grid.cells.size * grid.cell_m**2) * self._headings

    def _peak(self, grid: Grid) -> float:
        return self._right(grid) / math.sqrt(np.linalg.det(math.tau * self.covariance))

    def arrays(self, landmarks: Landmarks, grid: Grid) -> Mapping[str, NDArray[Any]]:
        size, row, precision = len(self.mean), np.zeros((1, 5)), np.zeros((1, 3, 3))
        row[0, :size] = self.mean
        row[0, 3:] = math.log(self._peak(grid)), self.share
        precision[0, :size, :size] = 0.5 * np.linalg.inv(self.covariance)
        return {"poses": row, "pose_precisions": precision}

    def log_average_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        return self.share * math.log1p(self._right(grid) / grid.free_m2 / self._headings)

    def largest_log_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        return math.log1p(self._peak(grid))

    def outlier_probability_at(self, pose: Pose, landmarks: Landmarks, grid: Grid) -> float:
        off = (pose[: len(self.mean)] - self.mean)[None]
        off[:, 2:] = wrap_angle(off[:, 2:])
        return float(1.0 / (1.0 + self._right(grid) * density(off, self.covariance)[0]))

    def draw(self, landmarks: Landmarks, grid: Grid, count: int, rng: np.random.Generator) -> Poses:
        poses = rng.uniform(-math.pi, math.pi, (count, 3))
        # Messages are checked: their covariances may be a little less symmetric than numpy wants.
        poses[:, : len(self.mean)] = rng.multivariate_normal(
            self.mean, self.covariance, count, check_valid="ignore"
        )
        poses[:, 2] = wrap_angle(poses[:, 2])
        return poses


class PoseFix(PositionFix):
    """The (3,) pose of the robot in the map, as from another localizer."""

    _headings = math.tau

    def moved(self, before_from_after: Pose) -> Self:
        x, y, _ = before_from_after.tolist()
        cos, sin = math.cos(self.mean[2]), math.sin(self.mean[2])
        by_heading = np.eye(3)
        by_heading[:2, 2] = -sin * x - cos * y, cos * x - sin * y
        mean = compose(self.mean, before_from_after)
        return replace(self, mean=mean, covariance=by_heading @ self.covariance @ by_heading.T)

    def blurred(self, by_m: float, by_rad: float) -> Self:
        added = np.diag([by_m**2, by_m**2, by_rad**2])
        return replace(self, covariance=self.covariance + added)
