"""Estimates the laser's mount and the scale of odometry, by hand-eye calibration.

The laser's motion A between two steps, measured in the map, and the robot's motion B, measured by
odometry, are one motion in two frames: A = X^-1 B X with the laser's mount X. In the plane this is
linear in X's position, and in its heading's cosine and sine times the scale of odometry. Turns are
taken from the laser, because odometry drifts; half of that drift is removed from B.
"""

import math

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from clustermcl.filter.arrays import Poses
from clustermcl.filter.poses import between, compose, wrap_angle

_APART_STEPS = 5
"""Number of steps of a motion, about a metre: much more than the error of poses in the map."""
_LEAST_MOVEMENTS = 30
_SOFT_M, _SOFT_RAD = 0.05, 0.02
_MOST_LAG_S, _LAG_STEP_S = 1.0, 0.05
_LEAST_KNOWN = 1e-6
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
    scale_errors: tuple[float, float]
    """Standard errors of both; on a circle, the distance and the laser's y are one unknown."""


def mount_of(map_from_laser: Poses, odom_from_robot: Poses) -> Mount | None:
    """Estimate the mount of the laser and the scale of odometry.

    Both poses, (N, 3), are of consecutive steps. None: there are too few, or the robot turns too
    little.
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
    noise = 2 * fit.cost / max(2 * len(laser) - 4, 1)
    variance, jacobian = _APART_STEPS * noise, np.asarray(fit.jac)
    # The motions have errors themselves, which seem to tell the unknowns apart: on a circle, the
    # scale of distances and the laser's position are one unknown.
    known, axes = np.linalg.eigh(jacobian.T @ jacobian - 2.0 * len(laser) * noise * np.eye(4))
    covariance = variance * (axes / np.maximum(known, _LEAST_KNOWN)) @ axes.T
    errors, along = np.sqrt(np.diag(covariance)), np.array([0.0, 0.0, cos, sin]) / scale
    turned = laser[:, 2] @ laser[:, 2]
    turn_scale = float(robot[:, 2] @ laser[:, 2] / turned)
    off_rad = wrap_angle(robot[:, 2] - turn_scale * laser[:, 2])
    turn_error = math.sqrt(_APART_STEPS * (off_rad @ off_rad) / len(laser) / turned)
    return Mount(
        robot_from_laser=(x / scale, y / scale, math.atan2(sin, cos)),
        standard_errors=(*errors[:2].tolist(), float(errors[2:].max()) / scale),
        odometry_distance_scale=scale,
        odometry_turn_scale=turn_scale,
        scale_errors=(math.sqrt(along @ covariance @ along), turn_error),
    )


class Lag(msgspec.Struct, frozen=True, kw_only=True):
    """How late the stamps of a laser are, by odometry's clock."""

    lag_s: float
    standard_error_s: float


def lag_of(
    map_from_laser: Poses,
    stamps_s: NDArray[np.float64],
    odometry_s: NDArray[np.float64],
    odometry_rad: NDArray[np.float64],
) -> Lag | None:
    """Estimate the lag of the laser's stamps: by how much turns in the map come before odometry's.

    Of (N, 3) poses of the laser at consecutive steps and their (N,) stamps, and (M,) headings of
    odometry without jumps of a full turn, at increasing stamps. None: as in `mount_of`.
    """
    turns = wrap_angle(np.diff(map_from_laser[:, 2]))
    if len(turns) < _LEAST_MOVEMENTS or np.abs(turns).sum() < _LEAST_TURN_RAD:
        return None

    def residuals(unknown: NDArray[np.float64]) -> NDArray[np.float64]:
        lag_s, scale = unknown
        turned = np.diff(np.interp(stamps_s - lag_s, odometry_s, odometry_rad))
        return np.asarray(wrap_angle(turned - scale * turns))

    starts = ((lag_s, 1.0) for lag_s in np.linspace(-_MOST_LAG_S, _MOST_LAG_S, 21))
    best = min(starts, key=lambda start: float(np.abs(residuals(np.array(start))).sum()))
    step = [_LAG_STEP_S, 0.01]
    fit = least_squares(residuals, best, loss="soft_l1", f_scale=_SOFT_RAD, diff_step=step)
    variance = 2 * fit.cost / (len(turns) - 2)
    lag, scale = fit.x.tolist()
    slope = (residuals(np.array([lag + _LAG_STEP_S, scale])) - residuals(fit.x)) / _LAG_STEP_S
    error_s = math.sqrt(variance / max(float(slope @ slope), 1e-12))
    return Lag(lag_s=lag, standard_error_s=error_s)
