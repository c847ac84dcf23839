"""The mount of a laser: its pose on the robot from pairs of poses, and whether it is tilted."""

import math
from collections.abc import Sequence

import numpy as np

from clustermcl.filter.poses import between
from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.rigid import Rigid

MAX_MOUNT_M = 10.0
"""Largest distance of a laser from the robot's centre [m]; beyond it, the data are wrong."""
MAX_TILT_RAD = 0.1
"""Largest tilt of a laser [rad]; at 10 m it changes a range by 5 cm."""

_SAME_PLACE_M, _SAME_HEADING_RAD = 0.01, 0.01


def mounting(odom_from_robot: PoseTuple, odom_from_laser: PoseTuple) -> PoseTuple:
    """Return the laser's pose on the robot, rounded to 0.1 mm, which logs resolve.

    Raises:
        ValueError: the laser is too far away to be on the robot.
    """
    x, y, heading = between(np.array(odom_from_robot), np.array(odom_from_laser)).tolist()
    if math.hypot(x, y) > MAX_MOUNT_M:
        raise ValueError(f"the laser is {math.hypot(x, y):.0f} m from the robot")
    return round(x, 4) + 0.0, round(y, 4) + 0.0, round(heading, 5) + 0.0  # no -0.0


def fixed_mounting(pairs: Sequence[tuple[PoseTuple, PoseTuple]]) -> PoseTuple | None:
    """Return the laser's pose on the robot, the median of pairs of poses of robot and laser.

    None: there are no pairs, they disagree, a laser is too far away, or the pose is zero.
    """
    try:
        mounts = np.array([mounting(robot, laser) for robot, laser in pairs])
    except ValueError:
        return None
    if len(mounts) == 0:
        return None
    middle = np.median(mounts, axis=0)
    if np.any(np.abs(mounts - middle) > (_SAME_PLACE_M, _SAME_PLACE_M, _SAME_HEADING_RAD)):
        return None
    x, y, heading = middle.tolist()
    mounted = math.hypot(x, y) > _SAME_PLACE_M or abs(heading) > _SAME_HEADING_RAD
    return (x, y, heading) if mounted else None


def is_upside_down(frame: str, base_from_laser: Rigid) -> bool:
    """Return whether a laser is mounted upside down, so that its beams run clockwise.

    Raises:
        ValueError: the laser's plane is not horizontal, or the laser is not on the robot.
    """
    up, away_m = base_from_laser.up(), math.hypot(base_from_laser.x, base_from_laser.y)
    tilt_rad = math.acos(min(abs(up), 1.0))
    if tilt_rad > MAX_TILT_RAD:
        raise ValueError(f"the laser {frame!r} is tilted by {math.degrees(tilt_rad):.0f} degrees")
    if away_m > MAX_MOUNT_M:
        raise ValueError(f"the laser {frame!r} is {away_m:.0f} m away")
    return up < 0.0
