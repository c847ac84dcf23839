"""The motion gate: a scan becomes a step only after the robot has moved."""

import math

from particle_filter.poses import wrap_angle
from process_runtime.settings import BridgeSettings
from protocol.message import PoseTuple


class MotionGate:
    """Opens for the first scan, and then after enough driving or turning since the last step.

    Scans of a standing robot are the same scan again; each would sharpen the belief as if it
    were news.
    """

    def __init__(self, settings: BridgeSettings) -> None:
        self._distance_m, self._turn_rad = settings.gate_distance_m, settings.gate_turn_rad
        self._last: PoseTuple | None = None
        self.is_held = False
        """Nothing passes; whoever has moved meanwhile passes as soon as it is released."""
        self.held_back = 0
        """Scans that would have passed."""

    def open_next(self) -> None:
        """Let the next scan through, however little the robot has moved."""
        self._last = None

    def passes(self, odom_from_robot: PoseTuple) -> bool:
        """Whether a scan at this pose becomes a step; if so, the next is measured from here."""
        if self._last is not None:
            driven_m = math.dist(odom_from_robot[:2], self._last[:2])
            turned_rad = abs(wrap_angle(odom_from_robot[2] - self._last[2]))
            if driven_m < self._distance_m and turned_rad < self._turn_rad:
                return False
        if self.is_held:
            self.held_back += 1
            return False
        self._last = odom_from_robot
        return True
