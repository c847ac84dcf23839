"""Readings far from those before them: outliers, or is it the world that has changed?

A single reading with a stamp of next year would make all that follow it late; a single wild
pose would cost the motion across it. Only the readings that come next can tell: if they go on
from where it all was, it was an outlier; if they go on from there, the clock was set or the
odometry began anew.
"""

from protocol.steps import Reading
from sensor_bridge.odometry_continuity import is_jump

MAX_AHEAD_NS = 10_000_000_000
"""A stamp may be so much later than the newest before it [ns] without a second one that agrees."""
CONFIRMED_BY = 3
"""So many readings in a row that agree with one another are no outliers."""
MAX_STEP_BACK_NS = 1_000_000_000
"""Readings may come so much late [ns]; stamps of real recordings step back by up to 0.9 s."""


class OutlierFilter:
    """Holds back what is far from all before, until the next readings tell.

    Attributes:
        held: readings that wait, at most `CONFIRMED_BY` - 1.
    """

    def __init__(self) -> None:
        self.held: list[Reading] = []
        self._last_pose: Reading | None = None

    def sifted(
        self, reading: Reading, newest_ns: int | None
    ) -> tuple[list[Reading], list[Reading]]:
        """Take the next reading in the order of arrival.

        Args:
            reading: checked already.
            newest_ns: the newest stamp of those used so far.

        Returns:
            readings to use now, in their order, and outliers.
        """
        ahead = newest_ns is not None and reading.stamp_ns > newest_ns + MAX_AHEAD_NS
        if not ahead and not self._jumps_from(self._last_pose, reading):
            outliers = self._contradicted_by(reading)
            if reading.odom_from_robot is not None:
                self._last_pose = reading
            return [reading], outliers
        outliers = []
        if self.held and not self._agrees(reading):
            outliers, self.held = self.held, []
        self.held.append(reading)
        return (self.released() if len(self.held) >= CONFIRMED_BY else []), outliers

    def jumps(self, reading: Reading) -> bool:
        """Whether a reading brings odometry that is far from that before."""
        return self._jumps_from(self._last_pose, reading)

    def released(self) -> list[Reading]:
        """What waits, for nothing follows that could tell more."""
        released, self.held = self.held, []
        for reading in released:
            if reading.odom_from_robot is not None:
                self._last_pose = reading
        return released

    def _contradicted_by(self, reading: Reading) -> list[Reading]:
        """Those held that a usual reading shows to be outliers; one without pose tells no place."""
        told = reading.odom_from_robot is not None
        outliers = [
            held for held in self.held if told or not self._jumps_from(self._last_pose, held)
        ]
        self.held = [held for held in self.held if held not in outliers]
        return outliers

    def _agrees(self, reading: Reading) -> bool:
        with_pose = [held for held in self.held if held.odom_from_robot is not None]
        before = with_pose[-1] if with_pose else None
        in_order = reading.stamp_ns >= self.held[-1].stamp_ns - MAX_STEP_BACK_NS
        return in_order and not self._jumps_from(before, reading)

    @staticmethod
    def _jumps_from(before: Reading | None, reading: Reading) -> bool:
        if before is None or before.odom_from_robot is None or reading.odom_from_robot is None:
            return False
        return is_jump(
            before.stamp_ns, before.odom_from_robot, reading.stamp_ns, reading.odom_from_robot
        )
