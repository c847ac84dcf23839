"""A way to ground that the robot has not seen yet, for a robot that is at none of its places."""

import math

import numpy as np

from clustermcl.filter.advice.roads import MARGIN_M, Roads
from clustermcl.filter.arrays import Points, Poses
from clustermcl.filter.cluster.view_memory import ViewMemory
from clustermcl.filter.laser.sensor_model import LaserScan, usable_beams

LEAST_M, MOST_M = 1.0, 10.0
"""Shortest and longest way [m]."""
_BESIDE_M = 1e-9
"""A hit exactly beside the robot counts as ahead, however its place is rounded [m]."""
_LANES = 72
_STEP_M = 0.2


def unseen_way(laser: LaserScan, seen: ViewMemory, radius_m: float, roads: Roads | None) -> Poses:
    """Find the straight way that ends farthest from all earlier views.

    The lane of the way is as wide as the robot and a margin, and ends before the first hit of the
    scan in it. Without a hit, a lane is not known to be free.

    Hits of all lasers count. `roads` are free at the places that are still possible; None: there is
    no place.

    Returns:
        (n, 3) poses relative to the robot, 0.2 m apart; none if no way of `LEAST_M` is free.
    """
    wide_m = radius_m + MARGIN_M
    bearings = np.arange(_LANES) * math.tau / _LANES
    ahead = np.column_stack([np.cos(bearings), np.sin(bearings)])
    hits, left = _hits(laser).T, np.column_stack([-ahead[:, 1], ahead[:, 0]])
    along, across = ahead @ hits, left @ hits
    in_lane = (np.abs(across) < wide_m) & (along > -_BESIDE_M)
    first_m = np.where(in_lane, along, np.inf).min(axis=1, initial=np.inf)
    free_m = np.minimum(np.where(np.isfinite(first_m), first_m - wide_m, 0.0), MOST_M)
    steps = np.arange(1, round(MOST_M / _STEP_M) + 1) * _STEP_M
    points = steps[:, None] * ahead[:, None]
    free = steps <= free_m[:, None]
    if roads is not None:
        free &= roads.are_sure(points)
    counts = np.logical_and.accumulate(free, axis=1).sum(axis=1)
    ends = (counts * _STEP_M)[:, None] * ahead
    views = np.concatenate([np.zeros((1, 2)), seen.rows[:, :2]])
    new_m = np.hypot(*(ends[:, None] - views).T).min(axis=0)
    new_m[counts * _STEP_M < LEAST_M] = 0.0
    best = int(new_m.argmax())
    if new_m[best] <= 0.0:
        return np.zeros((0, 3))
    way = np.zeros((counts[best] + 1, 3))
    way[1:, :2] = points[best, : counts[best]]
    way[1:, 2] = math.remainder(bearings[best], math.tau)
    return way


def _hits(laser: LaserScan) -> Points:
    """Return (n, 2) hits of a scan and of its others in the robot's frame [m]."""
    parts: list[Points] = []
    lasers: tuple[LaserScan, ...] = (laser, *laser.others)
    for one in lasers:
        hits = usable_beams(one.ranges, one.range_max_m, len(one.ranges))
        ranges = np.asarray(one.ranges, np.float64)
        parts.append(one.beams(ranges, hits, one.range_max_m).hits_in_robot)
    return np.concatenate(parts)
