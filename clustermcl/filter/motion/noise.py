"""The errors of odometry: standard deviations of a motion's parts, and covariances of poses."""

from math import atan2, cos, hypot, pi, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose
from clustermcl.filter.poses import heading_distance, wrap_angle
from clustermcl.filter.settings import MotionSettings

_NO_BEARING_BELOW_M = 0.01
"""Length of a drive below which its bearing is only noise, and is taken as zero [m]."""


def along_across_turn(motion: Pose, settings: MotionSettings) -> tuple[float, ...]:
    """Return bearing [rad], drive [m] and turn [rad], and the standard deviations along and across
    the drive [m] and of the turn [rad]."""
    drive, turn = hypot(motion[0], motion[1]), float(motion[2])
    drive_by_turn = settings.drive_noise_per_turn * turn
    return (
        atan2(motion[1], motion[0]) if drive > 0.0 else 0.0,
        drive,
        turn,
        hypot(settings.drive_noise_per_metre * drive, drive_by_turn),
        hypot(settings.strafe_noise_per_metre * drive, drive_by_turn),
        hypot(settings.turn_noise_per_turn * turn, settings.turn_noise_per_metre * drive),
    )


def turn_drive_turn(motion: Pose, settings: MotionSettings) -> tuple[float, ...]:
    """Return first turn, drive and second turn, and their standard deviations [rad, m, rad]."""
    drive = hypot(motion[0], motion[1])
    turn_1 = atan2(motion[1], motion[0]) if drive >= _NO_BEARING_BELOW_M else 0.0
    turn_2 = wrap_angle(float(motion[2]) - turn_1)
    # A drive backwards has two half turns in the formulas, but the robot does not turn.
    turned_1, turned_2 = (
        min(float(heading_distance(turn, 0.0)), float(heading_distance(turn, pi)))
        for turn in (turn_1, turn_2)
    )
    turn_by_drive = settings.turn_noise_per_metre * drive
    return (
        turn_1,
        drive,
        turn_2,
        hypot(settings.turn_noise_per_turn * turned_1, turn_by_drive),
        hypot(
            settings.drive_noise_per_metre * drive,
            settings.drive_noise_per_turn * hypot(turned_1, turned_2),
        ),
        hypot(settings.turn_noise_per_turn * turned_2, turn_by_drive),
    )


_ANY_HEADING_RAD2 = pi**2 / 3.0
"""Variance of an unknown heading [rad^2], up to which the linear formulas hold."""


def motion_covariance(before_from_after: Pose, settings: MotionSettings) -> NDArray[np.float64]:
    """Return the covariance of one motion with the noise that `motion.move` draws.

    It is V M V^T, with the covariance M of the motion's parts and their Jacobian V.

    Returns:
        (3, 3) covariance of x, y [m] and heading [rad], in the frame before the motion. Exact for
        the omnidirectional model, of first order for the differential one.

    References:
        Probabilistic Robotics (2005), section 7.4: V_t M_t V_t^T of table 7.2, there with the
        velocity model; here with the odometry model of table 5.6.
    """
    if settings.model == "differential":
        turn_1, drive, _, *sigmas = turn_drive_turn(before_from_after, settings)
        c, s = cos(turn_1), sin(turn_1)
        # Of x = drive cos(turn_1), y = drive sin(turn_1), heading = turn_1 + turn_2.
        parts = np.array([[-drive * s, c, 0.0], [drive * c, s, 0.0], [1.0, 0.0, 1.0]])
    else:
        bearing, _, _, *sigmas = along_across_turn(before_from_after, settings)
        c, s = cos(bearing), sin(bearing)
        parts = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    scaled = parts * np.array(sigmas)
    return np.asarray(scaled @ scaled.T)


def composed_covariance(
    a_from_b: Pose,
    of_a_from_b: NDArray[np.float64],
    b_from_c: Pose,
    of_b_from_c: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the covariance of `compose(a_from_b, b_from_c)` for independent errors.

    It is G S G^T + H Q H^T: an error in the heading of b moves c around b (G), and the covariance
    in the frame of b is turned to the frame of a (H).

    The (3,) poses are means; each (3, 3) covariance is in the frame of its pose's first letter, as
    is the result.

    References:
        Probabilistic Robotics (2005), table 7.2: G_t Sigma G_t^T + R_t.
    """
    c, s = cos(a_from_b[2]), sin(a_from_b[2])
    x, y, _ = b_from_c.tolist()
    swung = np.array([[1.0, 0.0, -s * x - c * y], [0.0, 1.0, c * x - s * y], [0.0, 0.0, 1.0]])
    swung[:, 2] *= sqrt(_ANY_HEADING_RAD2 / max(float(of_a_from_b[2, 2]), _ANY_HEADING_RAD2))
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(swung @ of_a_from_b @ swung.T + turned @ of_b_from_c @ turned.T)
