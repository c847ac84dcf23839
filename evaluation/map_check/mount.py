"""Where the laser sits and how odometry errs, from how both moved: hand-eye calibration.

What the laser moved by between two steps, as the map shows it, A, and what the robot moved by, as
odometry has it, B, are one movement seen from two places: with the laser at X on the robot,
A = X^-1 B X. In the plane that is linear in X's position, and in its heading's cosine and sine
times the scale of odometry. Turns are the laser's, for odometry drifts in them; where it has
drifted on the way, its movement is turned back by half of that.
"""

import math

import msgspec
import numpy as np
from scipy.optimize import least_squares

from particle_filter.arrays import Poses
from particle_filter.poses import between, compose, wrap_angle

_APART_STEPS = 5
"""Movements over so many steps: some metre, much longer than the map's poses err."""
_LEAST_MOVEMENTS = 30
_SOFT_M = 0.05
_LEAST_TURN_RAD = math.pi
"""The turns add up to this: without turning, the position of a laser does not show."""


class Mount(msgspec.Struct, frozen=True, kw_only=True):
    """The laser on the robot, and odometry, as a map and a recording say."""

    robot_from_laser: tuple[float, float, float]
    standard_errors: tuple[float, float, float]
    """[m], [m], [rad]."""
    odometry_distance_scale: float
    """1.02: odometry says 2 % more than was driven."""
    odometry_turn_scale: float
    """The same of turns."""


def mount_of(map_from_laser: Poses, odom_from_robot: Poses) -> Mount | None:
    """Estimate both at once.

    Args:
        map_from_laser: (N, 3) where the laser was at steps that follow each other.
        odom_from_robot: (N, 3) odometry at the same steps.

    Returns:
        None where the recording is too short or turns too little to tell.
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
        """(R_B - 1) t - scale R_X t_A + t_B, in metres of odometry."""
        x, y, cos, sin = unknown
        along = (c - 1) * x - s * y - cos * laser[:, 0] + sin * laser[:, 1] + moved[0]
        across = s * x + (c - 1) * y - sin * laser[:, 0] - cos * laser[:, 1] + moved[1]
        return np.concatenate([along, across])

    fit = least_squares(residuals, (0.0, 0.0, 1.0, 0.0), loss="soft_l1", f_scale=_SOFT_M)
    x, y, cos, sin = fit.x.tolist()
    scale = math.hypot(cos, sin)
    # Movements overlap: so many fewer are independent.
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
