"""Likelihoods of observations: of the robot's pose, and of landmarks in the robot's frame.

An observation is right with a Gaussian error, or false. A false sight of a landmark is a sight of
another landmark under a wrong name, or of nothing on the map. All likelihoods here are relative to
that of an observation of nothing, so a pose that explains an observation badly gets 0 nat.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import exp, hypot, log1p, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Pose, Poses
from particle_filter.grid import Grid
from particle_filter.kernels import kernel, plain
from particle_filter.poses import compose, wrap_angle

_NEGLIGIBLE = 200.0
"""Squared distance from a Gaussian's mean, in its variances, at which it is left out."""
_SIGHT_M2 = math.pi * 10.0**2
"""Area over which false sights of landmarks are spread [m^2]: a circle around the robot."""


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
    """What a sensor says about the robot's pose at a step."""

    mean: NDArray[np.float64]
    """The robot's (3,) pose or (2,) position in the map; or (2,) position of a landmark in the
    robot's frame."""
    covariance: NDArray[np.float64]
    """(2, 2) or (3, 3), positive definite."""
    landmark: str
    """Name of the landmark; empty: an observation of the robot's pose."""
    outlier_probability: float
    share: float = 1.0
    """Share of the log-likelihood that is new: errors of successive sights are correlated."""

    def blurred(self, by_m: float, by_rad: float) -> "Observation":
        """Return the observation for poses that stand for others as far away as this."""
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


def log_likelihood_ratio(
    poses: Poses, observations: Sequence[Observation], landmarks: Landmarks, grid: Grid
) -> LogWeights:
    """Return (N,) log-likelihood ratios of (N, 3) poses and "nothing on the map was observed".

    Args:
        poses: map_from_robot.
        observations: of one step.
        landmarks: of the map.
        grid: the map, over which false observations of the pose are spread.
    """
    total = np.zeros(len(poses))
    sights = [seen for seen in observations if seen.landmark]
    if sights and len(poses):
        names = np.array(landmarks.names)
        factors = [_factors(seen, landmarks, grid) for seen in sights]
        total += _at_landmarks(
            plain(poses),
            np.array([seen.mean for seen in sights]),
            np.array([seen.covariance for seen in sights]),
            np.array([seen.share for seen in sights]),
            plain(landmarks.positions),
            plain(landmarks.variances),
            np.array(
                [
                    any_landmark + right * (names == seen.landmark)
                    for seen, (right, any_landmark) in zip(sights, factors, strict=True)
                ]
            ),
        )
    for seen in observations:
        if not seen.landmark:
            right, _ = _factors(seen, landmarks, grid)
            ratio = right * _normal(_difference(poses, seen.mean), seen.covariance)
            total += seen.share * np.log1p(ratio)
    return total


@kernel
def _at_landmarks(
    poses: Poses,
    means: NDArray[np.float64],
    covariances: NDArray[np.float64],
    shares: NDArray[np.float64],
    positions: NDArray[np.float64],
    variances: NDArray[np.float64],
    factors: NDArray[np.float64],
) -> LogWeights:
    """Return (N,) sums over S sights of L landmarks; factors: (S, L) of the densities."""
    total, ratio = np.zeros(len(poses)), np.empty(len(poses))
    x0, y0, heading0 = poses[0]
    around, chord = 0.0, 0.0  # bounds of the differences between all poses and the first
    for i in range(len(poses)):
        around = max(around, hypot(poses[i, 0] - x0, poses[i, 1] - y0))
        chord = max(chord, abs(2.0 * sin(0.5 * (poses[i, 2] - heading0))))
    cosines, sines = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    for s in range(len(means)):
        ratio[:] = 0.0
        for mark in range(len(positions)):
            xx, xy = covariances[s, 0, 0] + variances[mark], covariances[s, 0, 1]
            yy = covariances[s, 1, 1] + variances[mark]
            x, y = positions[mark, 0] - x0, positions[mark, 1] - y0
            ahead = cosines[0] * x + sines[0] * y - means[s, 0]
            left = cosines[0] * y - sines[0] * x - means[s, 1]
            apart = hypot(ahead, left) - around - chord * hypot(x, y)
            if apart > 0.0 and apart**2 > _NEGLIGIBLE * (xx + yy):
                continue
            determinant = xx * yy - xy * xy
            scale = factors[s, mark] / (2.0 * pi * sqrt(determinant))
            for i in range(len(poses)):
                x, y = positions[mark, 0] - poses[i, 0], positions[mark, 1] - poses[i, 1]
                ahead = cosines[i] * x + sines[i] * y - means[s, 0]
                left = cosines[i] * y - sines[i] * x - means[s, 1]
                squares = yy * ahead * ahead - 2.0 * xy * ahead * left + xx * left * left
                ratio[i] += scale * exp(-0.5 * squares / determinant)
        for i in range(len(poses)):
            total[i] += shares[s] * log1p(ratio[i])
    return total


def log_average_ratio(
    observations: Sequence[Observation], landmarks: Landmarks, grid: Grid
) -> float:
    """Return the sum of log average likelihood ratios over all poses in the free space.

    The integral of a Gaussian over the map is one: its parts outside the free space are neglected.
    """
    if not observations:
        return 0.0
    free_m2 = max(int(np.count_nonzero(grid.cells == 0)), 1) * grid.cell_m**2
    total = 0.0
    for seen in observations:
        right, any_landmark = _factors(seen, landmarks, grid)
        if seen.landmark:
            named = landmarks.names.count(seen.landmark)
            ratio = (right * named + any_landmark * len(landmarks.names)) / free_m2
        else:
            ratio = right / free_m2 / (math.tau if len(seen.mean) == 3 else 1.0)
        total += seen.share * math.log1p(ratio)
    return total


def allowed_poses(
    observations: Sequence[Observation],
    landmarks: Landmarks,
    grid: Grid,
    count: int,
    rng: np.random.Generator,
) -> tuple[Poses, LogWeights]:
    """Draw poses that the most informative observation allows.

    Returns:
        At most (count, 3) poses in the free space; and their log weights: `count` times the average
        of weight times a function estimates the part of its average over the free space that the
        observation explains.
    """

    def average(seen: Observation) -> float:
        return math.expm1(log_average_ratio([replace(seen, share=1.0)], landmarks, grid))

    seen = max(observations, key=average)
    poses = rng.uniform(-math.pi, math.pi, (count, 3))
    if seen.landmark:
        right, any_landmark = _factors(seen, landmarks, grid)
        odds = any_landmark + right * (np.array(landmarks.names) == seen.landmark)
        chosen = rng.choice(len(odds), count, p=odds / odds.sum())
        spread = rng.normal(size=(count, 2)) * np.sqrt(landmarks.variances[chosen, None])
        x, y = (rng.multivariate_normal(seen.mean, seen.covariance, count) + spread).T
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        from_robot = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
        poses[:, :2] = landmarks.positions[chosen] - from_robot
    else:
        poses[:, : len(seen.mean)] = rng.multivariate_normal(seen.mean, seen.covariance, count)
        poses[:, 2] = wrap_angle(poses[:, 2])
    from particle_filter.sensor_model import ground_log_penalty  # noqa: PLC0415 - loads numba

    poses = poses[ground_log_penalty(poses, grid, -1.0) == 0.0]
    ratios = np.expm1(log_likelihood_ratio(poses, [replace(seen, share=1.0)], landmarks, grid))
    # Together with poses spread evenly, each is weighed by the density of both.
    return poses, -np.log1p(ratios / average(seen))


def _factors(seen: Observation, landmarks: Landmarks, grid: Grid) -> tuple[float, float]:
    """Return the factors of the density of a right one, and of a landmark with any name."""
    odds = 1.0 / seen.outlier_probability - 1.0
    if seen.landmark:  # half of the false sights are of another landmark
        return odds * 2.0 * len(set(landmarks.names)) * _SIGHT_M2, _SIGHT_M2
    area = grid.cells.size * grid.cell_m**2
    return odds * area * (math.tau if len(seen.mean) == 3 else 1.0), 0.0


def _difference(poses: Poses, mean: NDArray[np.float64]) -> NDArray[np.float64]:
    difference = poses[:, : len(mean)] - mean
    if len(mean) == 3:
        difference[:, 2] = wrap_angle(difference[:, 2])
    return difference


def _normal(
    difference: NDArray[np.float64], covariance: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (N,) densities of a Gaussian at (N, D) differences from its mean."""
    inverse = np.linalg.inv(covariance)
    squares = np.einsum("ni,ij,nj->n", difference, inverse, difference)
    scale = math.sqrt(np.linalg.det(math.tau * covariance))
    return np.asarray(np.exp(-0.5 * squares) / scale)
