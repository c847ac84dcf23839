"""Poses in the plane and arithmetic of angles.

A pose `a_from_b` transforms points of frame b to frame a; poses are chained by `compose(a_from_b,
b_from_c)`. All functions take one pose `(3,)` or many `(N, 3)`, and broadcast.
"""

import math
from typing import overload

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Poses


@overload
def wrap_angle(angle: float) -> float: ...
@overload
def wrap_angle(angle: NDArray[np.float64]) -> NDArray[np.float64]: ...
def wrap_angle(angle: float | NDArray[np.float64]) -> float | NDArray[np.float64]:
    """Return the same direction in [-pi, pi) [rad]; angles in this range are unchanged."""
    if not isinstance(angle, np.ndarray):
        if -math.pi <= angle < math.pi:
            return angle
        wrapped = angle - math.tau * math.floor((angle + math.pi) / math.tau)
        return wrapped if -math.pi <= wrapped < math.pi else -math.pi  # after rounding
    turned = angle.copy()
    outside = (angle < -np.pi) | (angle >= np.pi)
    if outside.any():
        far = angle[outside]
        far -= math.tau * np.floor((far + np.pi) / math.tau)
        far[(far < -np.pi) | (far >= np.pi)] = -np.pi
        turned[outside] = far
    return turned


def heading_distance(
    a: float | NDArray[np.float64], b: float | NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the angle between two headings, in [0, pi] [rad]."""
    return np.abs(wrap_angle(np.asarray(np.subtract(a, b), np.float64)))


def compose(a_from_b: Poses, b_from_c: Poses) -> Poses:
    """Chain (..., 3) poses to `a_from_c`, with headings in [-pi, pi)."""
    a_from_b, b_from_c = np.asarray(a_from_b, np.float64), np.asarray(b_from_c, np.float64)
    if a_from_b.ndim == b_from_c.ndim == 1:  # for one pose, plain numbers are five times as fast
        (x, y, heading), (along, across, turn) = a_from_b.tolist(), b_from_c.tolist()
        c, s = math.cos(heading), math.sin(heading)
        x, y = x + c * along - s * across, y + s * along + c * across
        return np.array([x, y, wrap_angle(heading + turn)])
    a_from_c = a_from_b + b_from_c  # has the right shape; x and y are replaced below
    cos, sin = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = b_from_c[..., 0], b_from_c[..., 1]
    a_from_c[..., 0] = a_from_b[..., 0] + cos * x - sin * y
    a_from_c[..., 1] = a_from_b[..., 1] + sin * x + cos * y
    a_from_c[..., 2] = wrap_angle(a_from_c[..., 2])
    return a_from_c


def inverse(a_from_b: Poses) -> Poses:
    """Return `b_from_a`, the inverse of (..., 3) poses; headings in [-pi, pi)."""
    a_from_b = np.asarray(a_from_b, np.float64)
    cos, sin = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    b_from_a = np.empty_like(a_from_b)
    b_from_a[..., 0] = -cos * a_from_b[..., 0] - sin * a_from_b[..., 1]
    b_from_a[..., 1] = sin * a_from_b[..., 0] - cos * a_from_b[..., 1]
    b_from_a[..., 2] = wrap_angle(-a_from_b[..., 2])
    return b_from_a


def between(a_from_b: Poses, a_from_c: Poses) -> Poses:
    """Return `b_from_c`, the (..., 3) pose of c in the frame of b.

    For two poses by odometry, it is the motion between them, in the frame of the first.
    """
    a_from_b = np.asarray(a_from_b, np.float64)
    # Differences first: far from the origin, products would lose digits.
    b_from_c = np.asarray(a_from_c, np.float64) - a_from_b
    if a_from_b.ndim == b_from_c.ndim == 1:  # as in `compose`
        (x, y, turn), heading = b_from_c.tolist(), float(a_from_b[2])
        c, s = math.cos(heading), math.sin(heading)
        return np.array([c * x + s * y, c * y - s * x, wrap_angle(turn)])
    cos, sin = np.cos(a_from_b[..., 2]), np.sin(a_from_b[..., 2])
    x, y = b_from_c[..., 0].copy(), b_from_c[..., 1].copy()
    b_from_c[..., 0] = cos * x + sin * y
    b_from_c[..., 1] = cos * y - sin * x
    b_from_c[..., 2] = wrap_angle(b_from_c[..., 2])
    return b_from_c
