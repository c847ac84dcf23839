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
    valid = np.flatnonzero(np.isfinite(ranges) & (ranges > 0.0) & (ranges < range_max_m))
    if len(valid) <= max_beams:
        return valid
    middles = (2 * np.arange(max_beams) + 1) * len(valid) // (2 * max_beams)
    return np.asarray(valid[middles])


def points_in_robot(
    ranges: NDArray[np.floating],
    angle_min: float,
    angle_step: float,
    robot_from_laser: Pose,
    indices: NDArray[np.int64],
) -> Points:
    """End points of the chosen beams in the robot's frame.

    Args:
        ranges: (n,) [m].
        angle_min: direction of beam 0 in the laser's frame [rad].
        angle_step: from one beam to the next, positive counter-clockwise [rad].
        robot_from_laser: (3,) where the laser sits on the robot.
        indices: (B,) beams to convert.

    Returns:
        (B, 2) points [m].
    """
    angles = robot_from_laser[2] + angle_min + angle_step * indices
    lengths = np.asarray(ranges, np.float64)[indices]
    return np.stack(
        [
            robot_from_laser[0] + lengths * np.cos(angles),
            robot_from_laser[1] + lengths * np.sin(angles),
        ],
        axis=-1,
    )
