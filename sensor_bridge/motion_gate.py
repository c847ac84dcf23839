"""The motion gate: a scan becomes a step only after the robot has moved."""

import math

from particle_filter.poses import wrap_angle
from process_runtime.settings import BridgeSettings
from protocol.message import PoseTuple

STANDS = 0.25
"""A robot that has moved by less than this share of the gate stands."""


class MotionGate:
    """Opens for the first scan, and then after enough driving or turning since the last step.

    Scans of a standing robot are the same scan again; each would sharpen the belief as if it
    were news.
    """

    def __init__(self, settings: BridgeSettings) -> None:
        self.settings = settings
        self._last: PoseTuple | None = None
        self._is_open = False
        self.is_held = False
        """Nothing passes; whoever has moved meanwhile passes as soon as it is released."""
        self.held_back = 0
        """Scans that would have passed."""

    def open_next(self) -> None:
        """Let the next scan through, however little the robot has moved."""
        self._is_open = True

    def begin_anew(self) -> None:
        """The next scan is the first."""
        self._last, self._is_open = None, False

    def resume(self, last: PoseTuple) -> None:
        """Continue after a step at this odometry."""
        self._last = last

    def has_hardly_moved(self, odom_from_robot: PoseTuple) -> bool:
        """Whether a robot there still stands where it was at the last step."""
        return self._last is not None and not self._has_moved(odom_from_robot, STANDS)

    def on_scan(self, odom_from_robot: PoseTuple) -> bool:
        """Whether a scan at this pose becomes a step; if so, the next is measured from here."""
        if not (self._is_open or self._has_moved(odom_from_robot)):
            return False
        if self.is_held:
            self.held_back += 1
            return False
        self._last, self._is_open = odom_from_robot, False
        return True

    def _has_moved(self, odom_from_robot: PoseTuple, share: float = 1.0) -> bool:
        if self._last is None:
            return True
        gate = self.settings
        driven_m = math.dist(odom_from_robot[:2], self._last[:2])
        turned_rad = abs(wrap_angle(odom_from_robot[2] - self._last[2]))
        return driven_m >= share * gate.gate_distance_m or turned_rad >= share * gate.gate_turn_rad
