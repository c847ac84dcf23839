"""Poses by time, and interpolation between them."""

import math
from bisect import bisect_left, insort
from operator import itemgetter
from typing import TypeAlias

import msgspec

from clustermcl.filter.poses import wrap_angle

PoseTuple: TypeAlias = tuple[float, float, float]
"""x [m], y [m], heading [rad]."""

MAX_EXTRAPOLATION_NS = 250_000_000
"""Longest time for which the motion at either end is extrapolated [ns]."""
MAX_LATE_NS = 1_000_000_000
"""Age, compared with the newest pose, above which a new pose shows a clock set back [ns]."""

_MAX_BLIND_NS = 2_000_000_000
_MAX_BLIND_M, _MAX_BLIND_RAD = 1.0, 1.0

_stamp = itemgetter(0)


class Trajectory(msgspec.Struct):
    """Poses by time."""

    most: int | None = None
    """Number of newest poses kept; None: all."""
    every_ns: int = 0
    """Least time between kept poses but for the newest [ns]."""
    held_ns: int | None = None
    """Time for which the first pose holds before it, and the last after it [ns]. None: the motion
    at the ends is extrapolated instead, for `MAX_EXTRAPOLATION_NS`."""
    poses: list[tuple[int, PoseTuple]] = []

    def __len__(self) -> int:
        return len(self.poses)

    def add(self, stamp_ns: int, pose: PoseTuple) -> None:
        """Insert a pose by its stamp.

        If it is older than the newest by more than `MAX_LATE_NS`, all others are removed.
        """
        poses = self.poses
        if poses and stamp_ns < poses[-1][0] - MAX_LATE_NS:
            poses.clear()
        if len(poses) > 1 and 0 <= stamp_ns - poses[-2][0] < self.every_ns:
            del poses[-1]
        insort(poses, (stamp_ns, pose), key=_stamp)
        if self.most is not None and len(poses) > self.most:
            del poses[0]

    def clear(self) -> None:
        self.poses.clear()

    @property
    def oldest_ns(self) -> int | None:
        """Stamp of the oldest pose; None: there is none."""
        return self.poses[0][0] if self.poses else None

    def reaches(self, stamp_ns: int) -> bool:
        """Return whether there is a pose of this time or later."""
        return bool(self.poses) and self.poses[-1][0] >= stamp_ns

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest pose; None: there is none."""
        return self.poses[-1][0] if self.poses else None

    def pose_at(self, stamp_ns: int) -> PoseTuple | None:
        """Return the pose at a time, interpolated; of several poses with this stamp, the first.

        None: there are no poses, the time is too far outside, or it is in a gap of more than 2 s
        with a motion of more than 1 m or 1 rad.
        """
        poses = self.poses
        if not poses:
            return None
        after = bisect_left(poses, stamp_ns, key=_stamp)
        if after < len(poses) and poses[after][0] == stamp_ns:
            return poses[after][1]
        outside_ns = max(poses[0][0] - stamp_ns, stamp_ns - poses[-1][0])
        if outside_ns > (MAX_EXTRAPOLATION_NS if self.held_ns is None else self.held_ns):
            return None
        if len(poses) == 1 or (outside_ns > 0 and self.held_ns is not None):
            return poses[0 if after == 0 else -1][1]
        after = min(max(after, 1), len(poses) - 1)
        (before_ns, start), (after_ns, end) = poses[after - 1], poses[after]
        if after_ns == before_ns:
            return end
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        x, y, turn = end[0] - start[0], end[1] - start[1], wrap_angle(end[2] - start[2])
        is_slow = math.hypot(x, y) <= _MAX_BLIND_M and abs(turn) <= _MAX_BLIND_RAD
        between = start[0] + share * x, start[1] + share * y, wrap_angle(start[2] + share * turn)
        return between if is_slow or after_ns - before_ns <= _MAX_BLIND_NS else None
