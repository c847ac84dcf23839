"""Convert poses and covariances between wire tuples and arrays."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clustermcl.protocol.message import MAX_POSE_M, Covariance, PoseTuple


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


def checked_pose(name: str, pose: ArrayLike, *, in_one_turn: bool = True) -> PoseTuple:
    """Return a pose, (3,) x [m], y [m], heading [rad], as a tuple.

    `in_one_turn` refuses a heading beyond a full turn, which is probably in degrees.

    Raises:
        ValueError: it is not three finite numbers, or out of range; with the argument's `name`.
    """
    values = np.asarray(pose, np.float64)
    if values.shape != (3,):
        raise ValueError(f"{name} is x, y, heading, not of shape {values.shape}: {pose!r}")
    x, y, heading = values.tolist()
    if not (abs(x) < MAX_POSE_M > abs(y) and math.isfinite(heading)):
        raise ValueError(f"{name} ({x}, {y}, {heading}) is not finite or farther than 1e8 m")
    if in_one_turn:
        check_angle(f"the heading of {name}", heading)
    return x, y, heading


def check_angle(name: str, angle_rad: float) -> None:
    """Raise ValueError if an angle is beyond a full turn."""
    if not abs(angle_rad) <= math.tau:
        raise ValueError(f"{name} is {angle_rad:g}, beyond a full turn (6.28): give radians")
