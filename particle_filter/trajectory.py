"""Where a robot was at any time: poses in the order of their times, and those in between."""

import math
from bisect import bisect_left, insort
from operator import itemgetter
from typing import TypeAlias

from particle_filter.poses import wrap_angle

PoseTuple: TypeAlias = tuple[float, float, float]
"""x [m], y [m], heading [rad]."""

MAX_EXTRAPOLATION_NS = 250_000_000
"""Where end poses do not hold, the motion beside them is taken to last this long [ns]."""
MAX_LATE_NS = 1_000_000_000
"""A pose this much older than the newest shows that the clock was set back [ns]."""

_MAX_BLIND_NS = 2_000_000_000
_MAX_BLIND_M, _MAX_BLIND_RAD = 1.0, 1.0

_stamp = itemgetter(0)


class Trajectory:
    """Poses by time.

    Args:
        most: poses kept, the newest; None: all.
        every_ns: poses closer together than this are thinned; the newest is always kept [ns].
        held_ns: the first pose holds this long before it, and the last after it [ns]. None: there
            the motion goes on instead, for `MAX_EXTRAPOLATION_NS`.
    """

    def __init__(
        self, most: int | None = None, *, every_ns: int = 0, held_ns: int | None = None
    ) -> None:
        self._most, self._every_ns, self._held_ns = most, every_ns, held_ns
        self._poses: list[tuple[int, PoseTuple]] = []

    def __len__(self) -> int:
        return len(self._poses)

    def add(self, stamp_ns: int, pose: PoseTuple) -> None:
        """Keep a pose; one that is a little late finds its place."""
        poses = self._poses
        if poses and stamp_ns < poses[-1][0] - MAX_LATE_NS:
            poses.clear()
        if len(poses) > 1 and 0 <= stamp_ns - poses[-2][0] < self._every_ns:
            del poses[-1]
        insort(poses, (stamp_ns, pose), key=_stamp)
        if self._most is not None and len(poses) > self._most:
            del poses[0]

    def clear(self) -> None:
        """Forget everything: what comes is of another time."""
        self._poses.clear()

    @property
    def oldest_ns(self) -> int | None:
        """Stamp of the oldest pose; None: there is none."""
        return self._poses[0][0] if self._poses else None

    def reaches(self, stamp_ns: int) -> bool:
        """Whether a pose of this time or later is known."""
        return bool(self._poses) and self._poses[-1][0] >= stamp_ns

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest pose; None: there is none."""
        return self._poses[-1][0] if self._poses else None

    def pose_at(self, stamp_ns: int) -> PoseTuple | None:
        """The pose at a time.

        At the time of a pose it is exactly that pose, of several the first. In between it is
        interpolated, the heading the short way round.

        Returns:
            None where nothing is known: too far outside, or in a gap of more than 2 s in which
            the robot moved by more than 1 m or 1 rad. Across a longer gap it may stand.
        """
        poses = self._poses
        if not poses:
            return None
        after = bisect_left(poses, stamp_ns, key=_stamp)
        if after < len(poses) and poses[after][0] == stamp_ns:
            return poses[after][1]
        outside_ns = max(poses[0][0] - stamp_ns, stamp_ns - poses[-1][0])
        if outside_ns > (MAX_EXTRAPOLATION_NS if self._held_ns is None else self._held_ns):
            return None
        if len(poses) == 1 or (outside_ns > 0 and self._held_ns is not None):
            return poses[0 if after == 0 else -1][1]
        after = min(max(after, 1), len(poses) - 1)
        (before_ns, start), (after_ns, end) = poses[after - 1], poses[after]
        if after_ns == before_ns:
            return end
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        known = _bridgeable(before_ns, start, after_ns, end)
        return _interpolated(start, end, share) if known else None


def _interpolated(start: PoseTuple, end: PoseTuple, share: float) -> PoseTuple:
    """The pose at a share of the way; beyond 0 and 1 the motion goes on."""
    x = start[0] + share * (end[0] - start[0])
    y = start[1] + share * (end[1] - start[1])
    return x, y, wrap_angle(start[2] + share * wrap_angle(end[2] - start[2]))


def _bridgeable(before_ns: int, start: PoseTuple, after_ns: int, end: PoseTuple) -> bool:
    """Whether what was between two poses can be told: the gap is short, or the robot stayed."""
    if after_ns - before_ns <= _MAX_BLIND_NS:
        return True
    moved_m = math.hypot(end[0] - start[0], end[1] - start[1])
    return moved_m <= _MAX_BLIND_M and abs(wrap_angle(end[2] - start[2])) <= _MAX_BLIND_RAD
