"""From the ranges of a scan to points around the robot."""

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import Points, Pose


def usable_beams(
    ranges: NDArray[np.floating], range_max_m: float, max_beams: int
) -> NDArray[np.int64]:
    """Choose the beams to score: the valid ones, thinned evenly.

    Invalid beams (not finite, not positive, `range_max_m` or longer) go first, so that a scan
    with many drop-outs still gives as many beams as it can.

    Args:
        ranges: (n,) [m].
        range_max_m: a reading this long is no return [m].
        max_beams: at most so many are chosen.

    Returns:
        (B,) increasing indices into `ranges`; empty where no beam is valid.

    Raises:
        ValueError: `max_beams` is not positive.
    """
    if max_beams < 1:
        raise ValueError(f"max_beams must be positive, not {max_beams}")
    ranges = np.asarray(ranges)
    # What is not finite is not below the range, be it infinite itself.
    valid = ((ranges > 0.0) & (ranges < range_max_m)).nonzero()[0]
    if len(valid) <= max_beams:
        return valid
    middles = (2 * np.arange(max_beams) + 1) * len(valid) // (2 * max_beams)
    return np.asarray(valid[middles])


def points_in_robot(
    ranges: NDArray[np.floating], angles: NDArray[np.float64], robot_from_laser: Pose
) -> Points:
    """End points of beams in the robot's frame.

    Args:
        ranges: (B,) [m].
        angles: (B,) directions in the laser's frame [rad].
        robot_from_laser: (3,) where the laser sits on the robot.

    Returns:
        (B, 2) points [m].
    """
    directions = robot_from_laser[2] + np.asarray(angles)
    lengths = np.asarray(ranges, np.float64)
    return np.stack(
        [
            robot_from_laser[0] + lengths * np.cos(directions),
            robot_from_laser[1] + lengths * np.sin(directions),
        ],
        axis=-1,
    )
