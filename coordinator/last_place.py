"""Where the robot was last: one hypothesis at the next start, also after a power cut."""

import math
from dataclasses import dataclass

import numpy as np

from coordinator.belief.given_places import diagonal
from coordinator.belief.prior_pose import PriorPose
from coordinator.checkpoint import state_in
from particle_filter.poses import between, compose
from protocol.message import Covariance, PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.steps import Scan
from protocol.work import Checkpoint

MOVED_BY_HAND = diagonal(0.5, 0.26)
"""While nobody looked, the robot may have been pushed so far: as when a person says where it is."""
ODOMETRY_STARTS_WITHIN = (0.5, 0.5)
"""Odometry this near to its origin [m], [rad] has probably been set to it."""


@dataclass(frozen=True)
class LastPlace:
    """The most probable place of an earlier life of the whole system."""

    map_digest: str
    live: bool
    """Whether it was a robot's, no recording's or simulation's."""
    odom_from_robot: PoseTuple
    map_from_robot: PoseTuple
    covariance: Covariance

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> "LastPlace | None":
        """The most probable place in a checkpoint; None where it has none.

        Raises:
            ValueError: as `state_in`.
        """
        state = state_in(checkpoint)
        applied, clusters = state.collector.applied, state.ensemble.clusters
        if applied is None or not clusters:
            return None
        best = max(clusters, key=lambda cluster: cluster.log_probability)
        return cls(
            map_digest=state.map_digest,
            live=applied.live,
            odom_from_robot=applied.odom_from_robot,
            map_from_robot=best.mean,
            covariance=best.covariance,
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


def _starts_anew(before: PoseTuple, now: PoseTuple) -> bool:
    near_m, near_rad = ODOMETRY_STARTS_WITHIN

    def near_origin(pose: PoseTuple) -> bool:
        return math.hypot(pose[0], pose[1]) < near_m and abs(pose[2]) < near_rad

    return near_origin(now) and not near_origin(before)
