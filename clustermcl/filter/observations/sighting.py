"""Observations of a landmark in the robot's frame, as by a camera that sees a tag."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.kind import NEGLIGIBLE, Kind, Landmarks, density
from clustermcl.filter.poses import between

_SIGHT_M2 = math.pi * 10.0**2
"""Area over which false observations of landmarks are spread [m^2]: a circle around the robot."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Sighting(Kind):
    """The (2,) position of a landmark in the robot's frame [m].

    A false one is of another landmark with a wrong name, or of nothing on the map.
    """

    landmark: str
    """Name of the landmark."""

    def moved(self, before_from_after: Pose) -> Self:
        cos, sin = math.cos(before_from_after[2]), math.sin(before_from_after[2])
        after_from_before = np.array([[cos, sin], [-sin, cos]])
        mean = after_from_before @ (self.mean - before_from_after[:2])
        covariance = after_from_before @ self.covariance @ after_from_before.T
        return replace(self, mean=mean, covariance=covariance)

    def blurred(self, by_m: float, by_rad: float) -> Self:
        added = by_m**2 + (math.hypot(*self.mean) * by_rad) ** 2
        return replace(self, covariance=self.covariance + added * np.eye(2))

    def _right(self, landmarks: Landmarks) -> float:
        """Return the factor of densities of landmarks with this name; `_SIGHT_M2` is that of all.

        Half of the false observations are of another landmark.
        """
        return self.odds * 2.0 * landmarks.distinct * _SIGHT_M2

    def _factors(self, landmarks: Landmarks) -> NDArray[np.float64]:
        """Return the (L,) factor of each landmark's density."""
        return np.asarray(_SIGHT_M2 + self._right(landmarks) * landmarks.named(self.landmark))

    def arrays(self, landmarks: Landmarks, grid: Grid) -> Mapping[str, NDArray[Any]]:
        xx, xy = self.covariance[0, 0] + landmarks.variances, self.covariance[0, 1]
        yy = self.covariance[1, 1] + landmarks.variances
        determinants = xx * yy - xy * xy
        scales = np.log(self._factors(landmarks) / (math.tau * np.sqrt(determinants)))
        precisions = np.stack([0.5 * yy, -xy + 0.0 * yy, 0.5 * xx], axis=-1)
        largest = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)
        return {
            "detections": np.array([[*self.mean, self.share]]),
            "scales": scales[None],
            "precisions": (precisions / determinants[:, None])[None],
            "reaches": np.sqrt(2.0 * largest * np.maximum(scales + NEGLIGIBLE, 0.0))[None],
        }

    def log_average_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        named = int(np.count_nonzero(landmarks.named(self.landmark)))
        all_named = self._right(landmarks) * named + _SIGHT_M2 * len(landmarks.names)
        return self.share * math.log1p(all_named / grid.free_m2)

    def largest_log_ratio(self, landmarks: Landmarks, grid: Grid) -> float:
        least = landmarks.variances[landmarks.named(self.landmark)].min()
        normal = math.sqrt(np.linalg.det(math.tau * (self.covariance + least * np.eye(2))))
        return math.log1p((self._right(landmarks) + _SIGHT_M2) / normal)

    def outlier_probability_at(self, pose: Pose, landmarks: Landmarks, grid: Grid) -> float:
        places = np.column_stack([landmarks.positions, np.zeros(len(landmarks.names))])
        covariances = self.covariance + landmarks.variances[:, None, None] * np.eye(2)
        densities = density(between(pose, places)[:, :2] - self.mean, covariances)
        return float(1.0 / (1.0 + self._factors(landmarks) @ densities))

    def draw(self, landmarks: Landmarks, grid: Grid, count: int, rng: np.random.Generator) -> Poses:
        poses, odds = rng.uniform(-math.pi, math.pi, (count, 3)), self._factors(landmarks)
        chosen = rng.choice(len(odds), count, p=odds / odds.sum())
        spread = rng.normal(size=(count, 2)) * np.sqrt(landmarks.variances[chosen, None])
        seen = rng.multivariate_normal(self.mean, self.covariance, count, check_valid="ignore")
        x, y = (seen + spread).T
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        from_robot = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        poses[:, :2] = landmarks.positions[chosen] - from_robot
        return poses
