"""Odometry at any time: recent poses, and the one in between."""

import math
from bisect import bisect_left, insort
from operator import itemgetter
from typing import TypeAlias

from particle_filter.poses import wrap_angle

PoseTuple: TypeAlias = tuple[float, float, float]
"""x [m], y [m], heading [rad]."""

MAX_EXTRAPOLATION_NS = 250_000_000
"""Before the first and after the last pose, the motion beside it is taken to last so long [ns]."""

_MAX_BLIND_NS = 2_000_000_000
_MAX_BLIND_M, _MAX_BLIND_RAD = 1.0, 1.0

_stamp = itemgetter(0)


class OdometryBuffer:
    """The most recent odometry poses, ordered by time.

    Args:
        capacity: poses kept.
    """

    def __init__(self, capacity: int = 200) -> None:
        self._capacity = capacity
        self._poses: list[tuple[int, PoseTuple]] = []

    def add(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        """Keep a pose; one that is a little late finds its place."""
        insort(self._poses, (stamp_ns, odom_from_robot), key=_stamp)
        if len(self._poses) > self._capacity:
            del self._poses[0]

    def clear(self) -> None:
        """Forget everything: what comes is of another time."""
        self._poses.clear()

    def reaches(self, stamp_ns: int) -> bool:
        """Whether odometry of this time or later is known."""
        return bool(self._poses) and self._poses[-1][0] >= stamp_ns

    def at(self, stamp_ns: int) -> PoseTuple | None:
        """The pose at a time.

        Between two poses it is interpolated, the heading the short way round. Before the first
        and after the last, the motion between the nearest two is taken to have lasted, for a
        quarter of a second at most.

        Returns:
            None where nothing is known: too far outside, or in a gap of more than 2 s in which
            the robot moved by more than 1 m or 1 rad. Across a longer gap it may stand.
        """
        poses = self._poses
        after = bisect_left(poses, stamp_ns, key=_stamp)
        if after < len(poses) and poses[after][0] == stamp_ns:
            return poses[after][1]
        if len(poses) < 2:
            near = bool(poses) and abs(poses[0][0] - stamp_ns) <= MAX_EXTRAPOLATION_NS
            return poses[0][1] if near else None
        outside_ns = max(poses[0][0] - stamp_ns, stamp_ns - poses[-1][0])
        if outside_ns > MAX_EXTRAPOLATION_NS:
            return None
        after = min(max(after, 1), len(poses) - 1)
        (before_ns, start), (after_ns, end) = poses[after - 1], poses[after]
        if not bridgeable(before_ns, start, after_ns, end):
            return None
        if after_ns == before_ns:
            return end
        return interpolated(start, end, (stamp_ns - before_ns) / (after_ns - before_ns))


def interpolated(start: PoseTuple, end: PoseTuple, share: float) -> PoseTuple:
    """The pose at a share of the way; beyond 0 and 1 the motion goes on.

    The heading turns the short way round.
    """
    x = start[0] + share * (end[0] - start[0])
    y = start[1] + share * (end[1] - start[1])
    return x, y, wrap_angle(start[2] + share * wrap_angle(end[2] - start[2]))


def bridgeable(before_ns: int, start: PoseTuple, after_ns: int, end: PoseTuple) -> bool:
    """Whether what was between two poses can be told: the gap is short, or the robot stayed."""
    if after_ns - before_ns <= _MAX_BLIND_NS:
        return True
    moved_m = math.hypot(end[0] - start[0], end[1] - start[1])
    return moved_m <= _MAX_BLIND_M and abs(wrap_angle(end[2] - start[2])) <= _MAX_BLIND_RAD
