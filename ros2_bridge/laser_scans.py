"""Convert laser scans of ROS to readings, once their transforms are known.

As in AMCL, odometry and the laser's pose are those of tf at the scan's stamp, ranges below
`range_min` are no return, a laser may be upside down, and several may share one topic.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Any

from process_runtime.ros2_settings import Ros2Settings
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.reading_checks import laser_problem
from protocol.steps import LaserReading
from recordings.headers import frame_name, stamp_of
from recordings.laser_mount import counter_clockwise
from recordings.rigid import Rigid
from recordings.transforms import TransformMissingError, TransformTree
from ros2_bridge.outputs import Refused

MAX_WAITING = 10
"""Limit for the scans of one laser that wait for tf, as in AMCL."""
_NOT_LOOKED_UP = TransformMissingError("arrived too late", cause="too many scans", may_come=False)


@dataclass(eq=False)
class _Waiting:
    scan: Any
    frame: str
    stamp_ns: int
    since_ns: int
    missing: TransformMissingError
    """Which transform was missing when it was last looked up."""


class LaserScans:
    """Queue of scans that wait for the transforms of their time."""

    def __init__(self, frames: TransformTree, settings: Ros2Settings) -> None:
        self.settings = settings
        self._frames = frames
        self._waiting: deque[_Waiting] = deque()
        self._missing_since_ns: dict[str, int] = {}

    def clear(self) -> None:
        self._waiting.clear()

    def add(self, scan: Any, now_ns: int) -> list[Refused]:
        """Queue a scan; refuse the oldest of its laser if more than `MAX_WAITING` wait.

        Args:
            scan: a `sensor_msgs/LaserScan`.
            now_ns: time on a monotonic clock.

        Raises:
            ValueError: its stamp is not a valid ROS time.
        """
        frame, stamp_ns = frame_name(scan.header.frame_id), stamp_of(scan.header)
        waiting = _Waiting(scan, frame, stamp_ns, now_ns, _NOT_LOOKED_UP)
        self._waiting.append(waiting)
        of_laser = [one for one in self._waiting if one.frame == frame]
        if len(of_laser) <= MAX_WAITING:
            return []
        self._waiting.remove(of_laser[0])
        return [self._refused(of_laser[0], now_ns)]

    def ready(self, now_ns: int) -> list[LaserReading | Refused]:
        """Remove scans whose transforms are known or late; return their readings or refusals."""
        done: list[LaserReading | Refused] = []
        still: deque[_Waiting] = deque()
        for waiting in self._waiting:
            try:
                done.append(self._reading(waiting))
                self._missing_since_ns.pop(waiting.frame, None)
            except TransformMissingError as missing:
                waiting.missing = missing
                self._missing_since_ns.setdefault(waiting.frame, waiting.since_ns)
                tolerance_ns = self.settings.transform_tolerance_s * 1e9
                if missing.may_come and now_ns - waiting.since_ns < tolerance_ns:
                    still.append(waiting)
                else:
                    done.append(self._refused(waiting, now_ns))
            except ValueError as problem:
                done.append(Refused("laser scan refused", str(problem)))
        self._waiting = still
        return done

    def _reading(self, waiting: _Waiting) -> LaserReading:
        settings, stamp_ns = self.settings, waiting.stamp_ns
        odom_from_base = self._frames.lookup(settings.odom_frame, settings.base_frame, stamp_ns)
        base_from_laser = self._frames.lookup(settings.base_frame, waiting.frame, stamp_ns)
        odometry = odom_from_base.planar()
        reading = laser_reading(waiting.scan, base_from_laser, odometry, settings)
        if problem := laser_problem(reading):
            raise ValueError(f"{waiting.frame!r}: {problem.replace('_', ' ')}")
        return reading

    def _refused(self, waiting: _Waiting, now_ns: int) -> Refused:
        since_ns = self._missing_since_ns.get(waiting.frame, waiting.since_ns)
        waited = f"waited for {(now_ns - since_ns) / 1e9:.1f} s"
        return Refused(
            f"laser scan without transform: {waiting.missing.cause}",
            f"laser {waiting.frame!r}, {waited}: {waiting.missing}",
        )


def laser_reading(
    scan: Any, base_from_laser: Rigid, odom_from_robot: PoseTuple, settings: Ros2Settings
) -> LaserReading:
    """Convert a `sensor_msgs/LaserScan`.

    Args:
        scan: the message.
        base_from_laser: pose of the laser on the robot.
        odom_from_robot: odometry at the scan's stamp.
        settings: range limits [m], and the sender's name.

    Raises:
        ValueError: the laser's plane is not horizontal, or the laser is not on the robot.
    """
    start, step, ranges = counter_clockwise(scan, base_from_laser, settings.laser_min_range_m)
    longest_m = settings.laser_max_range_m
    return LaserReading(
        sender=settings.node_name,
        stamp_ns=stamp_of(scan.header),
        ranges=ArrayBlob.of(ranges, "float32"),
        angle_min_rad=start,
        angle_step_rad=step,
        range_max_m=min(float(scan.range_max), longest_m if longest_m > 0.0 else math.inf),
        robot_from_laser=base_from_laser.planar(),
        odom_from_robot=odom_from_robot,
        laser=frame_name(scan.header.frame_id),
    )
