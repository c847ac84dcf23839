"""Poses and covariances as they travel, tuples, and as they are computed with, arrays.

The other way, a pose's array is just `np.array(pose)`.
"""

import numpy as np
from numpy.typing import NDArray

from protocol.message import Covariance, PoseTuple


def pose_tuple(pose: NDArray[np.float64]) -> PoseTuple:
    """A (3,) pose as it travels."""
    x, y, heading = pose.tolist()
    return (x, y, heading)


def covariance_tuple(covariance: NDArray[np.float64]) -> Covariance:
    """A (3, 3) covariance as it travels."""
    a, b, c, d, e, f, g, h, i = covariance.ravel().tolist()
    return (a, b, c, d, e, f, g, h, i)


def covariance_matrix(covariance: Covariance) -> NDArray[np.float64]:
    """A covariance that has travelled, (3, 3)."""
    return np.reshape(covariance, (3, 3))
