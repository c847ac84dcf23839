"""A robot that has not gone where its odometry says.

Wheels slip, somebody pushes it, or the odometry has lost the sign of a drive. No noise in
proportion to the drive reaches that far, and noise that does leaves corridors without a feature
badly known; so it is thought of only when a scan fits badly where odometry says.
"""

from math import atan2, hypot

import numpy as np

from particle_filter.arrays import Pose, Poses

_FARTHEST_BACK = 2.5
"""A slipped robot is at most so many times its drive behind where odometry says."""
_TURN_PER_METRE = 0.3
"""Spread of its heading [rad/m]."""


def slipped(
    map_from_before: Poses, map_from_after: Poses, motion: Pose, rng: np.random.Generator
) -> Poses:
    """Where particles are that have slipped on their way.

    Args:
        map_from_before: (N, 3) before the motion.
        map_from_after: (N, 3) after it, by odometry.
        motion: (3,) as odometry tells it, seen from the robot before.
        rng: how far each slips.

    Returns:
        (N, 3) anywhere from where odometry says to one and a half drives backwards.
    """
    drive, count = hypot(motion[0], motion[1]), len(map_from_after)
    bearing = map_from_before[:, 2] + atan2(motion[1], motion[0])
    back = _FARTHEST_BACK * drive * rng.random(count)
    turn = _TURN_PER_METRE * drive * rng.standard_normal(count)
    shift = np.column_stack([-back * np.cos(bearing), -back * np.sin(bearing), turn])
    return np.asarray(map_from_after + shift)
