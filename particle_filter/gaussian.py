"""The Gaussian through the particles of a cluster: the robot's estimate of its pose."""

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose, Poses
from particle_filter.poses import circular_mean, wrap_angle
from particle_filter.sums import weighted_products, weighted_sum


def fit_gaussian(poses: Poses, weights: NDArray[np.float64]) -> tuple[Pose, NDArray[np.float64]]:
    """Mean and covariance of weighted poses (section 4 of the paper, last paragraph).

    The heading's mean is circular and its deviations go the short way round, so that a cloud
    across +-pi is as narrow as any other. The covariance is that of the cloud itself, divided
    by the sum of weights: the maximum likelihood fit.

    Args:
        poses: (N, 3) x [m], y [m], heading [rad].
        weights: (N,) linear weights with any positive sum.

    Returns:
        (3,) mean pose and (3, 3) covariance [m^2, m rad, rad^2].

    Raises:
        ValueError: no poses, or the weights sum to zero or are not finite.
    """
    total = float(weights.sum())
    if not (0.0 < total < np.inf):
        raise ValueError(f"weights that sum to {total} fit no Gaussian")
    shares = weights / total
    # Deviations from one particle keep digits where coordinates are large.
    deviations = np.empty((3, len(poses)))
    x, y, turn = deviations
    np.subtract(poses[:, 0], poses[0, 0], out=x)
    np.subtract(poses[:, 1], poses[0, 1], out=y)
    heading = circular_mean(poses[:, 2], shares)
    mean_x, mean_y = weighted_sum(x, shares), weighted_sum(y, shares)
    x -= mean_x
    y -= mean_y
    turn[:] = wrap_angle(poses[:, 2] - heading)
    covariance = weighted_products(deviations, shares)
    mean = np.array([poses[0, 0] + mean_x, poses[0, 1] + mean_y, heading])
    return mean, 0.5 * (covariance + covariance.T)
