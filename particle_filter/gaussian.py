"""Fits a Gaussian to the particles of a cluster: the estimate of the robot's pose."""

from math import atan2, cos, floor, pi, sin

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose, Poses
from particle_filter.kernels import kernel, plain
from particle_filter.poses import wrap_angle


def fit_gaussian(poses: Poses, weights: NDArray[np.float64]) -> tuple[Pose, NDArray[np.float64]]:
    """Return mean and covariance of weighted poses (section 4 of the paper, last paragraph).

    The heading's mean is circular, and its deviations are wrapped to +-pi. The covariance is
    divided by the sum of weights: the maximum likelihood fit.

    Args:
        poses: (N, 3) x [m], y [m], heading [rad].
        weights: (N,) linear weights with any positive sum.

    Returns:
        (3,) mean pose and (3, 3) covariance [m^2, m rad, rad^2].

    Raises:
        ValueError: the sum of the weights is not positive and finite.
    """
    total = float(np.add.reduce(weights))
    if not (0.0 < total < np.inf):
        raise ValueError(f"weights that sum to {total} fit no Gaussian")
    mean, covariance = np.empty(3), np.empty((3, 3))
    _moments(plain(poses), plain(weights), total, mean, covariance)
    mean[2] = wrap_angle(float(mean[2]))
    return mean, covariance


def fit_gaussians(
    poses: Poses, weights: NDArray[np.float64], ends: NDArray[np.int64]
) -> tuple[Poses, NDArray[np.float64]]:
    """Fit a Gaussian to each part of the poses, as `fit_gaussian` does to all.

    Args:
        poses: (N, 3).
        weights: (N,) linear weights; those of a part have any positive sum.
        ends: (K + 1,) index where each part begins; the last one is N.

    Returns:
        (K, 3) mean poses and (K, 3, 3) covariances; zeros for a part without weight.
    """
    means, covariances = np.empty((len(ends) - 1, 3)), np.empty((len(ends) - 1, 3, 3))
    _moments_of_parts(plain(poses), plain(weights), ends, means, covariances)
    means[:, 2] = wrap_angle(means[:, 2])
    return means, covariances


@kernel
def _moments_of_parts(
    poses: Poses,
    weights: NDArray[np.float64],
    ends: NDArray[np.int64],
    means: Poses,
    covariances: NDArray[np.float64],
) -> None:
    for part in range(len(means)):
        first, end, total = ends[part], ends[part + 1], 0.0
        for i in range(first, end):
            total += weights[i]
        if total > 0.0:
            _moments(poses[first:end], weights[first:end], total, means[part], covariances[part])
        else:
            means[part], covariances[part] = 0.0, 0.0


@kernel
def _moments(
    poses: Poses, weights: NDArray[np.float64], total: float, mean: Pose, covariance: Poses
) -> None:
    """Write mean and covariance, in two passes; the mean heading is not wrapped.

    Deviations from the first particle keep digits if coordinates are large.
    """
    first_x, first_y, first_heading = poses[0, 0], poses[0, 1], poses[0, 2]
    x = y = along = across = 0.0
    for i in range(len(poses)):
        share, turn = weights[i] / total, poses[i, 2] - first_heading
        x += share * (poses[i, 0] - first_x)
        y += share * (poses[i, 1] - first_y)
        along += share * cos(turn)
        across += share * sin(turn)
    turned = atan2(across, along)
    xx = xy = yy = xt = yt = tt = 0.0
    for i in range(len(poses)):
        share = weights[i] / total
        dx, dy = poses[i, 0] - first_x - x, poses[i, 1] - first_y - y
        turn = poses[i, 2] - first_heading - turned
        turn -= 2.0 * pi * floor((turn + pi) / (2.0 * pi))
        xx += share * dx * dx
        xy += share * dx * dy
        yy += share * dy * dy
        xt += share * dx * turn
        yt += share * dy * turn
        tt += share * turn * turn
    mean[0], mean[1], mean[2] = first_x + x, first_y + y, first_heading + turned
    covariance[0, 0], covariance[1, 1], covariance[2, 2] = xx, yy, tt
    covariance[0, 1] = covariance[1, 0] = xy
    covariance[0, 2] = covariance[2, 0] = xt
    covariance[1, 2] = covariance[2, 1] = yt
