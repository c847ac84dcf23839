"""The pose of the robot's odom frame in the map.

The robot's odometry may jump when its base controller restarts; beliefs refer to odometry without
jumps. So each belief is combined with the odometry of its scan, corrected for later jumps.
"""

import numpy as np

from particle_filter.poses import compose, inverse
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple
from sensor_bridge.stages import OdometryContinuity

KEPT_SCANS = 2_000
"""Beliefs arrive one step after their scans, or some seconds late after a pause."""


class MapFromOdom:
    """Follows the odometry and computes map -> odom from the newest belief."""

    def __init__(self) -> None:
        self._continuity = OdometryContinuity()
        self._scans: dict[int, PoseTuple] = {}
        self._map_from_ours: PoseTuple | None = None

    def on_odometry(self, stamp_ns: int, odom_from_robot: PoseTuple) -> bool:
        """Handle the robot's odometry; return whether it jumped."""
        return self._continuity.jumped(stamp_ns, odom_from_robot)

    def on_scan(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        """Keep the odometry of a scan until its belief arrives."""
        self._scans[stamp_ns] = self._continuity.continuous(odom_from_robot)
        if len(self._scans) > KEPT_SCANS:
            del self._scans[next(iter(self._scans))]

    def forget_scans(self) -> None:
        """Drop all scans, after the clock was set back."""
        self._scans.clear()

    def expected(self, stamp_ns: int) -> PoseTuple | None:
        """The last pose, predicted by odometry to a scan; None: unknown."""
        ours = self._scans.get(stamp_ns)
        if ours is None or self._map_from_ours is None:
            return None
        return pose_tuple(compose(np.array(self._map_from_ours), np.array(ours)))

    def on_place(self, stamp_ns: int, map_from_robot: PoseTuple) -> bool:
        """Handle the robot's pose at a scan; return whether the scan is known."""
        ours = self._scans.get(stamp_ns)
        if ours is None:
            return False
        self._map_from_ours = pose_tuple(compose(np.array(map_from_robot), inverse(np.array(ours))))
        return True

    def forget_place(self) -> None:
        """The robot's pose is unknown from now on."""
        self._map_from_ours = None

    def place(self, odom_from_robot: PoseTuple) -> PoseTuple | None:
        """The current pose of the odom frame in the map; None: unknown.

        Args:
            odom_from_robot: the robot's newest odometry.
        """
        if self._map_from_ours is None:
            return None
        theirs = np.array(odom_from_robot)
        ours = np.array(self._continuity.continuous(odom_from_robot))
        map_from_robot = compose(np.array(self._map_from_ours), ours)
        return pose_tuple(compose(map_from_robot, inverse(theirs)))
