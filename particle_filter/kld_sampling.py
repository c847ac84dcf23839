"""How many particles a cloud needs: more where it is spread out, fewer where it is not."""

import math

import numpy as np

from particle_filter.arrays import Poses

BIN_M, BIN_RAD = 0.1, math.radians(5.0)
UPPER_QUANTILE = 2.326
"""Of the standard normal distribution at 0.99: the bound holds with this probability."""


def sufficient_particles(map_from_robot: Poses, error: float, least: int, most: int) -> int:
    """Particles for which the Kullback-Leibler distance to the true belief stays under a bound.

    Args:
        map_from_robot: (N, 3) poses; the bins they occupy are counted.
        error: bound on the distance.
        least: never fewer.
        most: never more.

    References:
        Fox, KLD-sampling (2001), eq. 9; Probabilistic Robotics (2005), table 8.4.
    """
    bins = np.floor(map_from_robot / np.array([BIN_M, BIN_M, BIN_RAD])).astype(np.int64)
    bins -= bins.min(axis=0)
    spans = bins.max(axis=0) + 1
    occupied = len(np.unique((bins[:, 0] * spans[1] + bins[:, 1]) * spans[2] + bins[:, 2]))
    if occupied < 2:
        return least
    k = occupied - 1.0
    share = 2.0 / (9.0 * k)
    count = k / (2.0 * error) * (1.0 - share + math.sqrt(share) * UPPER_QUANTILE) ** 3
    return min(max(math.ceil(count), least), most)
