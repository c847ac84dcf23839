"""Likelihoods of observations: of the robot's pose or position, and of landmarks in its frame.

An observation is right with a Gaussian error, or false. A false observation of a landmark is of
another landmark with a wrong name, or of nothing on the map. All likelihoods here are relative to
that of an observation of nothing, so a pose that explains an observation badly gets 0 nat. Those
of a field are relative to their average over the free space, see `position_fields`.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.position_fields import PositionField, ratios
from clustermcl.filter.poses import between, compose, wrap_angle

_SIGHT_M2 = math.pi * 10.0**2
"""Area over which false observations of landmarks are spread [m^2]: a circle around the robot."""


@dataclass(frozen=True)
class Landmarks:
    """The landmarks of a map."""

    names: tuple[str, ...]
    """(L,) name of each; landmarks of one class share their name."""
    positions: NDArray[np.float64]
    """(L, 2) x, y in the map [m]."""
    variances: NDArray[np.float64]
    """(L,) variance of a position along each axis [m^2]."""

    @classmethod
    def of(cls, rows: Iterable[tuple[str, float, float, float]]) -> "Landmarks":
        """Return the landmarks of rows: name, x [m], y [m], standard deviation [m]."""
        table = list(rows)
        sigmas = np.array([row[3] for row in table])
        positions = np.array([row[1:3] for row in table]).reshape(-1, 2)
        return cls(tuple(row[0] for row in table), positions, sigmas**2)


@dataclass(frozen=True)
class Observation:
    """What a sensor measured about the robot's pose at a step."""

    mean: NDArray[np.float64]
    """The robot's (3,) pose or (2,) position in the map; or (2,) position of a landmark in the
    robot's frame; or (2,) low corner of a field in the map."""
    covariance: NDArray[np.float64]
    """(2, 2) or (3, 3), positive definite."""
    landmark: str
    """Name of the landmark; empty: an observation of the robot's pose."""
    outlier_probability: float
    share: float = 1.0
    """Share of the log-likelihood that is new: errors of successive observations are correlated."""
    field: PositionField | None = None
    """Log-likelihoods of the robot's position; None: `mean` is observed."""

    def blurred(self, by_m: float, by_rad: float) -> "Observation":
        """Return a less certain observation, for poses that represent a neighbourhood."""
        far_m = math.hypot(*self.mean) if self.landmark else 0.0
        added = np.array([by_m**2 + (far_m * by_rad) ** 2] * 2 + [by_rad**2])[: len(self.mean)]
        return replace(self, covariance=self.covariance + np.diag(added))

    def moved(self, before_from_after: Pose) -> "Observation":
        """Return the observation as it would be after a motion (3,) of the robot.

        Of a position without heading, the direction of the motion is unknown: its length is added
        to the standard deviation.
        """
        x, y, turn = before_from_after.tolist()
        mean, covariance = self.mean, self.covariance
        if self.landmark:
            cos, sin = math.cos(turn), math.sin(turn)
            after_from_before = np.array([[cos, sin], [-sin, cos]])
            mean = after_from_before @ (mean - before_from_after[:2])
            covariance = after_from_before @ covariance @ after_from_before.T
        elif len(mean) == 2:
            covariance = covariance + (x**2 + y**2) * np.eye(2)
        else:
            cos, sin = math.cos(mean[2]), math.sin(mean[2])
            by_heading = np.eye(3)
            by_heading[:2, 2] = -sin * x - cos * y, cos * x - sin * y
            mean = compose(mean, before_from_after)
            covariance = by_heading @ covariance @ by_heading.T
        return replace(self, mean=mean, covariance=covariance)


NOTHING_OBSERVED: tuple[tuple[Observation, ...], Landmarks] = ((), Landmarks.of(()))


def log_average_ratio(
    observations: Sequence[Observation], landmarks: Landmarks, grid: Grid
) -> float:
    """Return the log of each observation's average likelihood ratio, summed over observations.

    The average is over all poses in the free space [nat]. The integral of a Gaussian over the map
    is one: its parts outside the free space are neglected.
    """
    if not observations:
        return 0.0
    total = 0.0
    for seen in observations:
        if seen.field is not None:
            continue  # its average is one
        right, any_landmark = factors(seen, landmarks, grid)
        if seen.landmark:
            named = landmarks.names.count(seen.landmark)
            ratio = (right * named + any_landmark * len(landmarks.names)) / grid.free_m2
        else:
            ratio = right / grid.free_m2 / (math.tau if len(seen.mean) == 3 else 1.0)
        total += seen.share * math.log1p(ratio)
    return total


def factors(seen: Observation, landmarks: Landmarks, grid: Grid) -> tuple[float, float]:
    """Return two factors of the likelihood ratio: for right observations, and for wrong names.

    The first multiplies the densities of landmarks with the observed name, or of the pose; the
    second those of all landmarks. An observation of nothing has the ratio 1.
    """
    odds = 1.0 / seen.outlier_probability - 1.0
    if seen.landmark:  # half of the false observations are of another landmark
        return odds * 2.0 * len(set(landmarks.names)) * _SIGHT_M2, _SIGHT_M2
    area = grid.cells.size * grid.cell_m**2
    return odds * area * (math.tau if len(seen.mean) == 3 else 1.0), 0.0


def largest_log_ratio(seen: Observation, landmarks: Landmarks, grid: Grid) -> float:
    """Return the log-likelihood ratio of an observation at the pose that it fits best [nat]."""
    if seen.field is not None:
        weights, false = seen.field.weights(seen.covariance), seen.outlier_probability
        return math.log(ratios(weights, np.full_like(weights, 1.0 / weights.size), false).max())
    right, any_landmark = factors(seen, landmarks, grid)
    covariance = seen.covariance
    if seen.landmark:
        named = np.array(landmarks.names) == seen.landmark
        covariance = covariance + landmarks.variances[named].min() * np.eye(2)
    return math.log1p((right + any_landmark) / math.sqrt(np.linalg.det(math.tau * covariance)))


def outlier_probability(pose: Pose, seen: Observation, landmarks: Landmarks, grid: Grid) -> float:
    """Return the probability that an observation is false if the robot is at a (3,) pose.

    That of a field is relative to the average over its cells.
    """
    if seen.field is not None:
        weights, false = seen.field.weights(seen.covariance), seen.outlier_probability
        of_cells = ratios(weights, np.full_like(weights, 1.0 / weights.size), false)
        col, row = np.floor((pose[:2] - seen.mean) / seen.field.cell_m)
        rows, cols = weights.shape
        inside = 0 <= col < cols and 0 <= row < rows
        return float(false / of_cells[int(row * cols + col) if inside else -1])
    right, any_landmark = factors(seen, landmarks, grid)
    if not seen.landmark:
        return float(
            1.0 / (1.0 + right * density(difference(pose[None], seen.mean), seen.covariance)[0])
        )
    places = np.column_stack([landmarks.positions, np.zeros(len(landmarks.names))])
    covariances = seen.covariance + landmarks.variances[:, None, None] * np.eye(2)
    densities = density(between(pose, places)[:, :2] - seen.mean, covariances)
    named = np.array(landmarks.names) == seen.landmark
    return float(1.0 / (1.0 + (any_landmark + right * named) @ densities))


def difference(poses: Poses, mean: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N, D) differences of (N, 3) poses from a (D,) mean: a pose or a position."""
    off = poses[:, : len(mean)] - mean
    if len(mean) == 3:
        off[:, 2] = wrap_angle(off[:, 2])
    return off


def density(off: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) densities at (N, D) differences from the mean of one Gaussian, or of N."""
    squares = (off[:, None] @ np.linalg.inv(covariance) @ off[:, :, None])[:, 0, 0]
    return np.asarray(np.exp(-0.5 * squares) / np.sqrt(np.linalg.det(math.tau * covariance)))
