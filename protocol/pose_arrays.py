"""Convert poses and covariances between wire tuples and arrays.

`np.array(pose)` converts a tuple to a pose array.
"""

import math

import numpy as np
from numpy.typing import NDArray

from protocol.message import Covariance, PoseTuple


def pose_tuple(pose: NDArray[np.float64]) -> PoseTuple:
    """Convert a (3,) pose to a wire tuple."""
    x, y, heading = pose.tolist()
    return (x, y, heading)


def covariance_tuple(covariance: NDArray[np.float64]) -> Covariance:
    """Convert a (3, 3) covariance to a wire tuple."""
    a, b, c, d, e, f, g, h, i = covariance.ravel().tolist()
    return (a, b, c, d, e, f, g, h, i)


def covariance_matrix(covariance: Covariance) -> NDArray[np.float64]:
    """Convert a wire tuple to a (3, 3) covariance."""
    return np.reshape(covariance, (3, 3))


def ellipse_axes(xx: float, xy: float, yy: float) -> tuple[float, float, float]:
    """Return the long and the short standard deviation of a position, and the long one's direction.

    Args:
        xx: variance of x [m²].
        xy: covariance of x and y [m²].
        yy: variance of y [m²].
    """
    middle, apart = (xx + yy) / 2.0, math.hypot((xx - yy) / 2.0, xy)
    long_m, short_m = (math.sqrt(max(v, 0.0)) for v in (middle + apart, middle - apart))
    return long_m, short_m, 0.5 * math.atan2(2.0 * xy, xx - yy)
