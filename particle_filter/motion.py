"""Odometry motion models: particles move as the robot did, each with its own error."""

from math import floor, pi

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose, Poses
from particle_filter.elementary_functions import cos_sin
from particle_filter.extensions import extension
from particle_filter.kernel_arguments import plain
from particle_filter.kernels import kernel
from particle_filter.motion_noise import along_across_turn, turn_drive_turn
from particle_filter.normal_numbers import standard_normals
from particle_filter.settings import MotionSettings


def move(
    map_from_robot: Poses,
    before_from_after: Pose,
    settings: MotionSettings,
    rng: np.random.Generator,
) -> Poses:
    """Draw every particle's next pose from p(x_t | u_t, x_{t-1}).

    Args:
        map_from_robot: (N, 3) poses before the motion.
        before_from_after: (3,) the motion: odometry's pose now, seen from its pose then.
        settings: motion model and noise, as standard deviations per metre and per radian.
        rng: gives N x 3 normal numbers, also when the robot stands still.

    Returns:
        (N, 3) new array; headings in [-pi, pi). Without motion there is no noise.

    References:
        Probabilistic Robotics (2005), table 5.6 (differential); nav2_amcl's OmniMotionModel
        (omnidirectional). nav2's alphas are variances: our noise is the root of an alpha.
    """
    noise = standard_normals(rng, 3, len(map_from_robot))
    return move_with_noise(map_from_robot, before_from_after, settings, noise)


def move_with_noise(
    map_from_robot: Poses,
    before_from_after: Pose,
    settings: MotionSettings,
    noise: NDArray[np.float32],
) -> Poses:
    """Move with standard normal numbers (3, N) from whatever sequence; else as `move`.

    Rows: along the drive, across it, turn; or first turn, drive, second turn.
    """
    poses = plain(map_from_robot)
    match settings.model:
        case "differential":
            return _turn_drive_turn(poses, turn_drive_turn(before_from_after, settings), noise)
        case "omnidirectional":
            along = along_across_turn(before_from_after, settings)
            return _drive_along_bearing(poses, along, noise)
        case name:
            moved: Poses = extension("motion_model", name)(
                poses, before_from_after, settings, noise
            )
            return moved


# Bearings in single precision: a drive of a metre ends at most 0.2 um beside.
@kernel
def _drive_along_bearing(
    poses: Poses, motion: tuple[float, ...], noise: NDArray[np.float32]
) -> Poses:
    bearing, drive, turn, along_sigma, across_sigma, turn_sigma = motion
    moved = np.empty_like(poses)
    for i in range(len(poses)):
        along = drive + along_sigma * np.float64(noise[0, i])
        across = across_sigma * np.float64(noise[1, i])
        c, s = cos_sin(poses[i, 2] + bearing)
        moved[i, 0] = poses[i, 0] + along * c - across * s
        moved[i, 1] = poses[i, 1] + along * s + across * c
        moved[i, 2] = _wrapped(poses[i, 2] + turn + turn_sigma * np.float64(noise[2, i]))
    return moved


@kernel
def _turn_drive_turn(poses: Poses, motion: tuple[float, ...], noise: NDArray[np.float32]) -> Poses:
    turn_1, drive, turn_2, turn_1_sigma, drive_sigma, turn_2_sigma = motion
    moved = np.empty_like(poses)
    for i in range(len(poses)):
        turned_1 = turn_1 + turn_1_sigma * np.float64(noise[0, i])
        driven = drive + drive_sigma * np.float64(noise[1, i])
        turned_2 = turn_2 + turn_2_sigma * np.float64(noise[2, i])
        c, s = cos_sin(poses[i, 2] + turned_1)
        moved[i, 0] = poses[i, 0] + driven * c  # table 5.6, line 8
        moved[i, 1] = poses[i, 1] + driven * s  # table 5.6, line 9
        moved[i, 2] = _wrapped(poses[i, 2] + turned_1 + turned_2)  # table 5.6, line 10
    return moved


@kernel
def _wrapped(heading: float) -> float:
    """As `poses.wrap_angle`."""
    wrapped = heading - 2.0 * pi * floor((heading + pi) / (2.0 * pi))
    return wrapped if -pi <= wrapped < pi else -pi
