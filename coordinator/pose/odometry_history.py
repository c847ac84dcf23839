"""Where the robot was by odometry in the last seconds: a person's word may be of then."""

from bisect import bisect_left
from collections import deque
from operator import itemgetter

import numpy as np

from particle_filter.poses import between, compose
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple

KEPT_NS = 5_000_000_000
EVERY_NS = 100_000_000
"""Odometry that comes faster is thinned: in between, the robot goes straight."""
SLACK_NS = 1_000_000_000
"""So much before the oldest is taken for the oldest: whoever speaks has a clock of his own."""

_stamp = itemgetter(0)


class OdometryHistory:
    """Odometry of the last five seconds, and the newest."""

    def __init__(self) -> None:
        self._poses: deque[tuple[int, PoseTuple]] = deque()

    def add(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        """Remember a pose; where the clock was set back, those before mean nothing any more."""
        poses = self._poses
        if poses and stamp_ns < poses[-1][0]:
            poses.clear()
        if len(poses) > 1 and stamp_ns < poses[-2][0] + EVERY_NS:
            poses.pop()
        poses.append((stamp_ns, odom_from_robot))
        while poses[0][0] < stamp_ns - KEPT_NS:
            poses.popleft()

    @property
    def oldest_ns(self) -> int | None:
        """Stamp of the oldest pose; None before the first."""
        return self._poses[0][0] if self._poses else None

    def at(self, stamp_ns: int | None) -> tuple[int, PoseTuple] | None:
        """Odometry at a time, with its stamp.

        Args:
            stamp_ns: when; None: now. What is later than the newest is now.

        Returns:
            None where it is not known: too long ago, or before the first odometry.
        """
        poses = self._poses
        if not poses:
            return None
        if stamp_ns is None or stamp_ns >= poses[-1][0]:
            return poses[-1]
        after = bisect_left(poses, stamp_ns, key=_stamp)
        if after == 0:
            return poses[0] if stamp_ns >= poses[0][0] - SLACK_NS else None
        (before_ns, start), (after_ns, end) = poses[after - 1], poses[after]
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        first = np.array(start)
        moved = share * between(first, np.array(end))
        return stamp_ns, pose_tuple(compose(first, moved))
