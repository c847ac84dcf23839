"""Convert poses and covariances between wire tuples and arrays.

`np.array(pose)` converts a tuple to a pose array.
"""

import numpy as np
from numpy.typing import NDArray

from clustermcl.protocol.message import Covariance, PoseTuple


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
