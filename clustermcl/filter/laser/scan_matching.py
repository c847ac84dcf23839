"""How a robot has moved by two scans of its laser, where these contradict its odometry.

Wheels slip, and some bases report drives in the wrong direction. Two scans show it whatever the map
is, so a building that has changed raises no false alarm.
"""

from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Points, Pose, Poses
from clustermcl.filter.laser.sensor_model import LaserScan, usable_beams
from clustermcl.filter.poses import between, compose

_BEAMS, _LEAST_BEAMS = 90, 20
"""Beams of the later scan that are compared, at most and at least."""
_EXPLAINED, _MORE = 0.6, 0.2
"""Odometry is wrong if it explains less of a scan than the first share, and another motion explains
more than that, and more than odometry by the second."""
_APART_M, _APART_RAD = 0.2, 0.2
"""Least difference of that motion from odometry's, which its noise does not explain [m], [rad]."""
_PER_METRE, _PER_RAD = 0.3, 0.1
"""How much more a motion has to explain, by its difference: along a corridor, all explain much."""
_GRIDS = ((0.2, 5, 2, 0.1, 5, 3), (0.05, 2, 2, 0.025, 2, 1))
"""Distance between positions [m], their number ahead and aside; the same for headings [rad]; and
of how many beams one is compared."""
_PER_RANGE = 0.02
"""Ranges of the same wall differ by this share, and by a position's distance to the next [m/m]."""


def motion_by_scans(before: LaserScan, after: LaserScan, by_odometry: Pose) -> Pose | None:
    """Return the robot's (3,) motion between two scans; None: odometry, or nothing, explains them.

    Motions near odometry's are tried: up to 1.1 m along, 0.5 m across and 0.55 rad off.

    References:
        Lu and Milios, "Robot pose estimation in unknown environments by matching 2D range scans"
        (1997): ends of beams are compared with the earlier range in their direction.
    """
    if min(len(_compared(before)), len(_compared(after))) < _LEAST_BEAMS:
        return None
    ends, finest_m = _ends_in_robot(after), _GRIDS[-1][0]
    explained_by_odometry = _explained(before, ends, by_odometry[np.newaxis], finest_m)[0]
    if explained_by_odometry >= _EXPLAINED:
        return None
    best, explained = by_odometry, 0.0
    for *grid, beams in _GRIDS:
        motions = compose(best, _offsets(*grid))
        off = between(by_odometry, motions)
        cost = _PER_METRE * np.hypot(off[:, 0], off[:, 1]) + _PER_RAD * np.abs(off[:, 2])
        shares = _explained(before, ends[::beams], motions, grid[0])
        chosen = int(np.argmax(shares - cost))
        best, explained = motions[chosen], shares[chosen]
    along, across, turn = between(by_odometry, best)
    is_apart = np.hypot(along, across) > _APART_M or abs(turn) > _APART_RAD
    least = max(_EXPLAINED, explained_by_odometry + _MORE)
    return best if is_apart and explained > least else None


def _compared(scan: LaserScan) -> NDArray[np.int64]:
    """Return the indices of the beams that are compared."""
    return usable_beams(np.asarray(scan.ranges, np.float64), scan.range_max_m, _BEAMS)


def _ends_in_robot(scan: LaserScan) -> Points:
    """Return the (n, 2) ends of some beams in the robot's frame [m]."""
    chosen = _compared(scan)
    ranges, directions = np.asarray(scan.ranges, np.float64)[chosen], scan.angles[chosen]
    in_laser = np.column_stack(
        [ranges * np.cos(directions), ranges * np.sin(directions), np.zeros(len(chosen))]
    )
    return compose(scan.robot_from_laser, in_laser)[:, :2]


@cache
def _offsets(step_m: float, ahead: int, aside: int, step_rad: float, turns: int) -> Poses:
    """Return (M, 3) motions on a grid around none."""
    counts = ((step_m, ahead), (step_m, aside), (step_rad, turns))
    return np.array(list(product(*(step * np.arange(-n, n + 1) for step, n in counts))))


def _explained(
    before: LaserScan, ends: Points, motions: Poses, width_m: float
) -> NDArray[np.float64]:
    """Return how near the ends are to the earlier ranges after each of (M, 3) motions, 0 to 1.

    It is an average over the ends in the earlier view; 0 if these are less than half.
    """
    laser_from_robot = between(before.robot_from_laser, motions)
    c, s = np.cos(laser_from_robot[:, 2:]), np.sin(laser_from_robot[:, 2:])
    x = laser_from_robot[:, :1] + c * ends[:, 0] - s * ends[:, 1]
    y = laser_from_robot[:, 1:2] + s * ends[:, 0] + c * ends[:, 1]
    distances = np.hypot(x, y)
    count, step = len(before.ranges), before.angle_step
    angles = (np.arctan2(y, x) - before.angle_min) % (2.0 * np.pi)
    lower = (np.minimum(angles, count * step) / step).astype(np.int64)
    ranges = np.append(np.asarray(before.ranges, np.float64), (np.inf, np.inf))
    ranges[~((ranges > 0.0) & (ranges < before.range_max_m))] = np.inf
    apart = np.minimum(abs(ranges[lower] - distances), abs(ranges[lower + 1] - distances))
    nearness = np.exp(-0.5 * np.square(apart / (width_m + _PER_RANGE * distances)))
    in_view = np.isfinite(apart).sum(axis=1)
    return np.where(2 * in_view < len(ends), 0.0, nearness.sum(axis=1) / np.maximum(in_view, 1))
