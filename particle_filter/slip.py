"""A robot that has not gone where its odometry says.

Wheels slip, somebody pushes it, or the odometry has lost the sign of a drive. No noise in
proportion to the drive reaches that far, and noise that does leaves corridors without a feature
badly known; so it is thought of only when a scan fits badly where odometry says.
"""

from math import atan2, hypot

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Pose, Poses
from particle_filter.elementary_functions import cos_sin
from particle_filter.kernel_arguments import plain
from particle_filter.kernels import kernel
from particle_filter.normal_numbers import standard_normals

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
    x, y, _ = motion.tolist()
    back, turned = rng.random(len(map_from_after)), standard_normals(rng, 1, len(map_from_after))[0]
    numbers = atan2(y, x), -_FARTHEST_BACK * hypot(x, y), _TURN_PER_METRE * hypot(x, y)
    return _slipped(plain(map_from_before), plain(map_from_after), numbers, back, turned)


@kernel
def _slipped(
    before: Poses,
    after: Poses,
    numbers: tuple[float, float, float],
    back: NDArray[np.float64],
    turned: NDArray[np.float32],
) -> Poses:
    """Numbers: the drive's bearing, how far back at most, spread of the heading."""
    bearing, farthest, spread = numbers
    slipped = np.empty_like(after)
    for i in range(len(after)):
        c, s = cos_sin(before[i, 2] + bearing)
        slipped[i, 0] = after[i, 0] + farthest * back[i] * c
        slipped[i, 1] = after[i, 1] + farthest * back[i] * s
        slipped[i, 2] = after[i, 2] + spread * np.float64(turned[i])
    return slipped
