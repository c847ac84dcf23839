"""Where the frame of odometry is in the map, as the robot itself counts odometry.

The system's own frame of odometry does not jump; the robot's may, when its base controller
restarts. So each belief is held against the odometry that the robot told at that scan, and a jump
since then is taken back.
"""

import numpy as np

from particle_filter.poses import compose, inverse
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple
from sensor_bridge.odometry_continuity import OdometryContinuity

KEPT_SCANS = 2_000
"""Beliefs come a step after their scans, or some seconds after a pause."""


class MapFromOdom:
    """Follows odometry, and knows the map's place against it since the first belief."""

    def __init__(self) -> None:
        self._continuity = OdometryContinuity()
        self._scans: dict[int, PoseTuple] = {}
        self._map_from_ours: PoseTuple | None = None

    def on_odometry(self, stamp_ns: int, odom_from_robot: PoseTuple) -> bool:
        """Take odometry as the robot tells it; whether its frame jumped before it."""
        return self._continuity.jumped(stamp_ns, odom_from_robot)

    def on_scan(self, stamp_ns: int, odom_from_robot: PoseTuple) -> None:
        """Remember where odometry was at a scan, for the belief that it may lead to."""
        self._scans[stamp_ns] = self._continuity.continuous(odom_from_robot)
        if len(self._scans) > KEPT_SCANS:
            del self._scans[next(iter(self._scans))]

    def forget_scans(self) -> None:
        """The clock was set back: stamps mean other scans from now on."""
        self._scans.clear()

    def expected(self, stamp_ns: int) -> PoseTuple | None:
        """Where the robot was at a scan, by the place told last; None: nothing is known."""
        ours = self._scans.get(stamp_ns)
        if ours is None or self._map_from_ours is None:
            return None
        return pose_tuple(compose(np.array(self._map_from_ours), np.array(ours)))

    def on_place(self, stamp_ns: int, map_from_robot: PoseTuple) -> bool:
        """Take where the robot was at a scan; False: that scan is not known."""
        ours = self._scans.get(stamp_ns)
        if ours is None:
            return False
        self._map_from_ours = pose_tuple(compose(np.array(map_from_robot), inverse(np.array(ours))))
        return True

    def forget_place(self) -> None:
        """Nobody knows where the robot is."""
        self._map_from_ours = None

    def place(self, odom_from_robot: PoseTuple) -> PoseTuple | None:
        """The frame of odometry in the map now; None: nobody knows.

        Args:
            odom_from_robot: the robot's newest odometry.
        """
        if self._map_from_ours is None:
            return None
        theirs = np.array(odom_from_robot)
        ours = np.array(self._continuity.continuous(odom_from_robot))
        map_from_robot = compose(np.array(self._map_from_ours), ours)
        return pose_tuple(compose(map_from_robot, inverse(theirs)))
