"""Odometry whose frame may jump, made continuous.

A robot whose base controller restarts counts from zero again: its odometry jumps although it did
not. Workers move their particles by the difference of two odometry poses, and would throw them
by the jump. Nobody can know the motion in between from odometry; that there was none is the best
guess, and the motion noise of the filter covers the little there can have been.
"""

import math

import numpy as np

from particle_filter.poses import compose, inverse, wrap_angle
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple

MAX_SPEED_M_PER_S, MAX_TURN_RATE_RAD_PER_S = 10.0, 10.0
"""Faster is no motion of a robot in a building."""
MAX_JUMP_M = 100.0
"""Farther between two readings is no motion, however long it took."""

_SLACK_M, _SLACK_RAD = 1.0, 1.0  # stamps err, made up ones most of all
_MAX_BACK_S = 10.0


class OdometryContinuity:
    """Carries odometry poses into one frame that does not jump."""

    def __init__(self) -> None:
        self._last: tuple[int, PoseTuple] | None = None
        self._ours_from_theirs: PoseTuple | None = None

    def jumped(self, stamp_ns: int, odom_from_robot: PoseTuple) -> bool:
        """Take the next pose, in the order of arrival; whether the frame jumped before it.

        After a jump, `continuous` makes the new pose equal to the last one. A single wild pose
        is two jumps, and the second undoes the first.
        """
        last, self._last = self._last, (stamp_ns, odom_from_robot)
        if last is None or not is_jump(*last, stamp_ns, odom_from_robot):
            return False
        ours = np.array(self.continuous(last[1]))
        correction = compose(ours, inverse(np.array(odom_from_robot)))
        self._ours_from_theirs = pose_tuple(correction)
        return True

    def continuous(self, odom_from_robot: PoseTuple) -> PoseTuple:
        """The pose in the continuous frame; the same, bit for bit, before the first jump."""
        if self._ours_from_theirs is None:
            return odom_from_robot
        return pose_tuple(compose(np.array(self._ours_from_theirs), np.array(odom_from_robot)))


def is_jump(before_ns: int, start: PoseTuple, after_ns: int, end: PoseTuple) -> bool:
    """Whether no robot can have come from one pose to the other in that time."""
    elapsed_s = (after_ns - before_ns) / 1e9
    if elapsed_s < -_MAX_BACK_S:
        elapsed_s = 0.0  # the clock was set back; how long it took, it does not tell
    moved_m = math.dist(start[:2], end[:2])
    turned_rad = abs(wrap_angle(end[2] - start[2]))
    return (
        moved_m > min(MAX_JUMP_M, _SLACK_M + MAX_SPEED_M_PER_S * abs(elapsed_s))
        or turned_rad > _SLACK_RAD + MAX_TURN_RATE_RAD_PER_S * abs(elapsed_s)
    )  # fmt: skip
