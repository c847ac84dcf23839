"""Fits a Gaussian to the particles of a cluster: the estimate of the robot's pose."""

from collections.abc import Sequence
from math import atan2, cos, erf, floor, hypot, pi, prod, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.kernels.compiled import kernel, plain
from clustermcl.filter.poses import wrap_angle


def fit_gaussian(poses: Poses, weights: NDArray[np.float64]) -> tuple[Pose, NDArray[np.float64]]:
    """Return mean and covariance of weighted poses (section 4 of the paper, last paragraph).

    The heading's mean is circular, and its deviations are wrapped to +-pi. The covariance is
    divided by the sum of weights: the maximum likelihood fit.

    Returns:
        (3,) mean pose and (3, 3) covariance [m^2, m rad, rad^2] of (N, 3) poses.

    Raises:
        ValueError: the sum of the weights is not positive and finite.
    """
    total = float(np.add.reduce(weights))
    if not (0.0 < total < np.inf):
        raise ValueError(f"weights that sum to {total} fit no Gaussian")
    ends, totals = np.array([0, len(poses)]), np.array([total])
    means, covariances = fit_gaussians(poses, weights, ends, totals)
    return means[0], covariances[0]


def fit_gaussians(
    poses: Poses, weights: NDArray[np.float64], ends: NDArray[np.int64], totals: NDArray[np.float64]
) -> tuple[Poses, NDArray[np.float64]]:
    """Fit a Gaussian to each part of (N, 3) poses, as `fit_gaussian` does to all.

    The parts begin at the (K + 1,) `ends`, of which the last is N; `totals` are their (K,) weights.

    Returns:
        (K, 3) mean poses and (K, 3, 3) covariances; zeros for a part without weight.
    """
    means, covariances = np.zeros((len(totals), 3)), np.zeros((len(totals), 3, 3))
    _moments(plain(poses), plain(weights), ends, totals, means, covariances)
    means[:, 2] = wrap_angle(means[:, 2])
    return means, covariances


def share_near_mean(covariance: Sequence[float], reach_m: float, reach_rad: float) -> float:
    """Return the share of a Gaussian that is near its mean.

    Near is within `reach_m` along both axes of the ellipse of its position, and within `reach_rad`.

    Args:
        covariance: (9,) row by row [m^2, m rad, rad^2].
        reach_m: positive distance [m].
        reach_rad: positive angle [rad].
    """
    xx, xy, _, _, yy, _, _, _, turn = covariance
    middle, half = (xx + yy) / 2.0, hypot((xx - yy) / 2.0, xy)
    reaches = ((middle + half, reach_m), (max(middle - half, 0.0), reach_m), (turn, reach_rad))
    return prod(erf(reach / sqrt(2.0 * variance)) for variance, reach in reaches if variance > 0.0)


@kernel
def _moments(
    all_poses: Poses,
    all_weights: NDArray[np.float64],
    ends: NDArray[np.int64],
    totals: NDArray[np.float64],
    means: Poses,
    covariances: NDArray[np.float64],
) -> None:
    """Write mean and covariance of each part, in two passes; the mean heading is not wrapped.

    Deviations from the first particle keep digits if coordinates are large.
    """
    for part in range(len(totals)):
        total = totals[part]
        if not total > 0.0:
            continue
        own = slice(ends[part], ends[part + 1])
        poses, weights = all_poses[own], all_weights[own]
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
        mean, covariance = means[part], covariances[part]
        mean[0], mean[1], mean[2] = first_x + x, first_y + y, first_heading + turned
        covariance[0, 0], covariance[1, 1], covariance[2, 2] = xx, yy, tt
        covariance[0, 1] = covariance[1, 0] = xy
        covariance[0, 2] = covariance[2, 0] = xt
        covariance[1, 2] = covariance[2, 1] = yt
