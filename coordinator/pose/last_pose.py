"""Where the robot was last: one hypothesis at the next start, also after a power cut."""

import math

import msgspec
import numpy as np

from coordinator.belief.given_places import diagonal
from coordinator.belief.prior_pose import PriorPose
from particle_filter.poses import between, compose
from protocol.answers import Belief
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.steps import Scan

MOVED_BY_HAND = diagonal(0.5, 0.26)
"""While nobody looked, the robot may have been pushed so far: as when a person says where it is."""
ODOMETRY_STARTS_WITHIN = (0.5, 0.5)
"""Odometry this near to its origin [m], [rad] has probably been set to it."""


class LastPose(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The most probable place, when it was the only probable one."""

    map_digest: str
    stamp_ns: int
    odom_from_robot: PoseTuple
    map_from_robot: PoseTuple
    covariance: Covariance
    probability: float

    @classmethod
    def of(cls, belief: Belief, map_digest: str) -> "LastPose | None":
        """The most probable place of a belief; None where it is not sure."""
        if belief.state != "localized":
            return None
        best = belief.hypotheses[0]
        return cls(
            map_digest=map_digest,
            stamp_ns=belief.stamp_ns,
            odom_from_robot=belief.odom_from_robot,
            map_from_robot=best.mean,
            covariance=best.covariance,
            probability=best.probability,
        )

    def as_prior_at(self, scan: Scan, probability: float) -> PriorPose:
        """The place as it would be at a scan, wide enough for what happened in between.

        The odometry since is counted if it goes on; where it has started anew, the robot stands
        where it stood.
        """
        pose = np.array(self.map_from_robot)
        if not _starts_anew(self.odom_from_robot, scan.odom_from_robot):
            moved = between(np.array(self.odom_from_robot), np.array(scan.odom_from_robot))
            pose = compose(pose, moved)
        a, b, c, d, e, f, g, h, i = (
            x + y for x, y in zip(self.covariance, MOVED_BY_HAND, strict=True)
        )
        return PriorPose(
            step=scan.step,
            odom_from_robot=scan.odom_from_robot,
            map_from_robot=pose_tuple(pose),
            covariance=(a, b, c, d, e, f, g, h, i),
            probability=probability,
        )

    def problem(self) -> str | None:
        """Why this cannot be a pose; None where it can."""
        numbers = (*self.odom_from_robot, *self.map_from_robot, *self.covariance)
        if not all(map(math.isfinite, numbers)):
            return "a number in it is not finite"
        return None


def _starts_anew(before: PoseTuple, now: PoseTuple) -> bool:
    near_m, near_rad = ODOMETRY_STARTS_WITHIN

    def near_origin(pose: PoseTuple) -> bool:
        return math.hypot(pose[0], pose[1]) < near_m and abs(pose[2]) < near_rad

    return near_origin(now) and not near_origin(before)
