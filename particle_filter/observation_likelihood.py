"""Likelihoods of observations at many poses, and poses that observations allow."""

import math
from collections.abc import Sequence
from dataclasses import replace
from math import exp, hypot, log1p, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Poses
from particle_filter.grid import Grid
from particle_filter.kernels import kernel, plain
from particle_filter.observations import (
    Landmarks,
    Observation,
    density,
    difference,
    factors,
    log_average_ratio,
)
from particle_filter.poses import wrap_angle
from particle_filter.sensor_model import ground_log_penalty

_NEGLIGIBLE = 200.0
"""Squared distance from a Gaussian's mean, in its variances, at which it is left out."""


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
        of_sights = [factors(seen, landmarks, grid) for seen in sights]
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
                    for seen, (right, any_landmark) in zip(sights, of_sights, strict=True)
                ]
            ),
        )
    for seen in observations:
        if not seen.landmark:
            right, _ = factors(seen, landmarks, grid)
            ratio = right * density(difference(poses, seen.mean), seen.covariance)
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
        right, any_landmark = factors(seen, landmarks, grid)
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
    poses = poses[ground_log_penalty(poses, grid, -1.0) == 0.0]
    ratios = np.expm1(log_likelihood_ratio(poses, [replace(seen, share=1.0)], landmarks, grid))
    # Together with poses spread evenly, each is weighed by the density of both.
    return poses, -np.log1p(ratios / average(seen))
