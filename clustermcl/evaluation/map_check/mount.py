"""Estimates the laser's mount and the scale of odometry, by hand-eye calibration.

The laser's motion A between two steps, measured in the map, and the robot's motion B, measured by
odometry, are one motion in two frames: A = X^-1 B X with the laser's mount X. In the plane this is
linear in X's position, and in its heading's cosine and sine times the scale of odometry. Turns are
taken from the laser, because odometry drifts; half of that drift is removed from B.
"""

import math

import msgspec
import numpy as np
from scipy.optimize import least_squares

from clustermcl.filter.arrays import Poses
from clustermcl.filter.poses import between, compose, wrap_angle

_APART_STEPS = 5
"""Number of steps of a motion, about a metre: much more than the error of poses in the map."""
_LEAST_MOVEMENTS = 30
_SOFT_M = 0.05
_LEAST_TURN_RAD = math.pi
"""Least sum of all turns; without turns the laser's position is not observable."""


class Mount(msgspec.Struct, frozen=True, kw_only=True):
    """Mount of the laser and scale of odometry, estimated from a map and a recording."""

    robot_from_laser: tuple[float, float, float]
    standard_errors: tuple[float, float, float]
    """Standard errors of `robot_from_laser`: x [m], y [m], heading [rad]."""
    odometry_distance_scale: float
    """Distance by odometry, divided by the driven distance."""
    odometry_turn_scale: float
    """Turn by odometry, divided by the true turn."""


def mount_of(map_from_laser: Poses, odom_from_robot: Poses) -> Mount | None:
    """Estimate the mount of the laser and the scale of odometry.

    Args:
        map_from_laser: (N, 3) laser poses at consecutive steps.
        odom_from_robot: (N, 3) odometry at the same steps.

    Returns:
        None if there are too few steps, or the robot turns too little.
    """
    laser = between(map_from_laser[:-_APART_STEPS], map_from_laser[_APART_STEPS:])
    robot = between(odom_from_robot[:-_APART_STEPS], odom_from_robot[_APART_STEPS:])
    turned_rad = np.abs(laser[:, 2]).sum() / _APART_STEPS
    if len(laser) < _LEAST_MOVEMENTS or turned_rad < _LEAST_TURN_RAD:
        return None
    half_drift = wrap_angle(laser[:, 2] - robot[:, 2]) / 2
    drifted = np.column_stack([np.zeros((len(robot), 2)), half_drift])
    moved = compose(drifted, robot)[:, :2].T
    c, s = np.cos(laser[:, 2]), np.sin(laser[:, 2])

    def residuals(unknown: np.ndarray) -> np.ndarray:
        """Return (R_B - 1) t - scale R_X t_A + t_B of all motions, in metres of odometry."""
        x, y, cos, sin = unknown
        along = (c - 1) * x - s * y - cos * laser[:, 0] + sin * laser[:, 1] + moved[0]
        across = s * x + (c - 1) * y - sin * laser[:, 0] - cos * laser[:, 1] + moved[1]
        return np.concatenate([along, across])

    fit = least_squares(residuals, (0.0, 0.0, 1.0, 0.0), loss="soft_l1", f_scale=_SOFT_M)
    x, y, cos, sin = fit.x.tolist()
    scale = math.hypot(cos, sin)
    # Motions overlap, so only this fraction is independent.
    variance = _APART_STEPS * 2 * fit.cost / max(2 * len(laser) - 4, 1)
    jacobian = np.asarray(fit.jac)
    errors = np.sqrt(np.diag(variance * np.linalg.inv(jacobian.T @ jacobian)))
    turn_scale = float(robot[:, 2] @ laser[:, 2] / (laser[:, 2] @ laser[:, 2]))
    return Mount(
        robot_from_laser=(x / scale, y / scale, math.atan2(sin, cos)),
        standard_errors=(*errors[:2].tolist(), float(errors[2:].max()) / scale),
        odometry_distance_scale=scale,
        odometry_turn_scale=turn_scale,
    )
