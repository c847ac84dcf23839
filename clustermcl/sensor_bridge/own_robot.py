"""Finds beams of a laser that end on the robot itself, and removes them from its scans.

A post or a cable before the laser has the same short range in nearly all scans. If these are a
fifth of the beams, no place explains a scan.
"""

from collections import deque
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.errors import printable
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.reading_checks import laser_problem
from clustermcl.protocol.steps import LaserReading
from clustermcl.sensor_bridge.refused import Refused
from clustermcl.sensor_bridge.stages import moved

FARTHEST_M, SAME_M = 0.45, 0.05
"""Largest range of a part of the robot, and largest difference from its median [m]."""
COMPARED, APART_M, APART_RAD = 20, 0.1, 0.1
"""Scans that are compared, and the motion from each to the next."""
LEAST_WAY_M, LEAST_TURN_RAD = 1.0, 1.0
"""Motion over all these scans: beside a wall, ranges are the same until the robot turns."""
FOUND, KEPT = 0.95, 0.5
"""Share of the scans in which a beam has the same short range when it is found, and later."""
MOST = 0.5
"""Largest share of a laser's beams that are taken for the robot."""
HARMLESS = 0.1
"""Up to this share of such beams, the robot is found in spite of them."""


class OwnRobot:
    """Sets beams that end on the robot to "no return"; a scan without others is dropped.

    `found`: many beams were found since this was set to False.
    """

    def __init__(self, dropped: Refused) -> None:
        self._dropped, self.found = dropped, False
        self._views: dict[str, deque[tuple[PoseTuple, NDArray[np.floating]]]] = {}
        self._masks: dict[str, NDArray[np.bool_]] = {}
        """By laser, whether each beam ends on the robot; without an entry, none does."""

    def __call__(self, reading: LaserReading) -> Iterator[LaserReading]:
        ranges = reading.ranges.array()
        self._learn(reading, ranges)
        mask = self._masks.get(reading.laser)
        if mask is not None:
            left = ArrayBlob.of(np.where(mask, 0.0, ranges), "float32")
            reading = replace(reading, ranges=left)
            if problem := laser_problem(reading):
                self._dropped[problem] += 1
                return
        yield reading

    def _learn(self, reading: LaserReading, ranges: NDArray[np.floating]) -> None:
        pose, name = reading.odom_from_robot, reading.laser
        assert pose is not None  # of the synchroniser
        views = self._views.setdefault(name, deque(maxlen=COMPARED))
        if views and len(views[-1][1]) != len(ranges):
            views.clear()
            self._masks.pop(name, None)
        if views:
            moved_m, turned_rad = moved(views[-1][0], pose)
            if moved_m < APART_M and turned_rad < APART_RAD:
                return
        views.append((pose, ranges))
        before = self._masks.get(name, np.zeros(len(ranges), bool))
        candidates = before | ((ranges > reading.range_min_m) & (ranges < FARTHEST_M))
        if len(views) < COMPARED or not candidates.any():
            return
        seen = np.array([view[candidates] for _, view in views], np.float64)
        usual = np.median(seen, axis=0)
        with np.errstate(invalid="ignore"):  # infinity less infinity
            share = np.mean(np.abs(seen - usual) <= SAME_M, axis=0) * (usual < FARTHEST_M)
        ways = np.array([moved(a, b) for (a, _), (b, _) in pairwise(views)])
        way_m, turn_rad = ways.sum(axis=0).tolist()
        mask = before.copy()
        mask[candidates] &= share >= KEPT
        if way_m >= LEAST_WAY_M and turn_rad >= LEAST_TURN_RAD:
            mask[candidates] |= share >= FOUND
        if not 0.0 < np.mean(mask) <= MOST:
            self._masks.pop(name, None)
            return
        self._masks[name] = mask
        if (mask & ~before).any():
            self.found |= bool(np.mean(mask) > HARMLESS)
            longest_m = float(usual[mask[candidates]].max())
            self._dropped.add(Cause.OWN_ROBOT, _sentence(reading, mask, longest_m))


def _sentence(reading: LaserReading, mask: NDArray[np.bool_], longest_m: float) -> str:
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2)
    first, last = edges[:, 0], edges[:, 1] - 1
    degrees = np.degrees(reading.angle_min_rad + reading.angle_step_rad * np.stack([first, last]))
    sectors = [f"{a:.0f} to {b:.0f}" for a, b in degrees.T[:8].tolist()]
    name = f"{printable(reading.laser, 60)}: " if reading.laser else ""
    more = ", ..." if len(first) > len(sectors) else ""
    return (
        f"{name}{np.count_nonzero(mask)} of {len(mask)} beams, {', '.join(sectors)}{more} deg in "
        f"its frame, end within {longest_m:.2f} m in nearly all scans and are left out"
    )
