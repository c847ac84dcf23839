"""Readings of a robot as numpy arrays, and an iterator over the readings of a recording."""

from __future__ import annotations  # `help` shows names of types, not their definitions

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import check_angle, checked_pose
from clustermcl.protocol.steps import MAX_BEAMS, LaserReading, OdometryReading
from clustermcl.runtime.settings import Settings

_SENDER = "library"
_NAMES = {
    "angle_min": "angle_min_rad", "angle_step": "angle_step_rad", "range_max": "range_max_m",
    "range_min": "range_min_m", "laser": "laser", "upside_down": "upside_down",
}  # fmt: skip
"""Fields of a reading, and their names in messages."""


@dataclass(frozen=True, eq=False, repr=False)
class Reading:
    """A scan, an odometry pose, or both with the same stamp.

    If a scan has no odometry, its pose is interpolated between earlier and later readings.

    Args:
        odom_from_robot: x [m], y [m], heading [rad] by odometry; None: unknown at this time.
        ranges: (B,) ranges [m], counter-clockwise; not finite, <= 0 or >= `range_max`: no return.
            None: there is no scan.
        angle_min: direction of the first beam in the laser's frame [rad].
        angle_step: angle from each beam to the next [rad].
        range_max: maximum range of the laser [m].
        range_min: minimum range of the laser [m]; shorter ranges count as no return.
        stamp_ns: time by the robot's clock [ns]. None: one second after the last reading; then
            times matter only in the check of odometry for jumps.
        robot_from_laser: mount of the laser: x [m], y [m], heading [rad]. None: that of
            `ClusterMCL`.
        laser: name of the laser, for a robot with several.
        upside_down: whether the laser is mounted upside down, so that its beams run clockwise.

    Raises:
        ValueError: there is neither a scan nor odometry, an array is empty or has the wrong
            shape, a number is not finite, `range_max` is missing, or an angle is in degrees.
    """

    odom_from_robot: Sequence[float] | NDArray[np.floating] | None = None
    ranges: ArrayLike | None = None
    angle_min: float = 0.0
    angle_step: float = 0.0
    range_max: float = 0.0
    range_min: float = 0.0
    stamp_ns: int | None = None
    robot_from_laser: PoseTuple | None = None
    laser: str = ""
    upside_down: bool = False

    def __post_init__(self) -> None:
        if self.ranges is None and self.odom_from_robot is None:
            raise ValueError("a reading has a scan, odometry, or both: both are None")
        if self.odom_from_robot is not None:
            checked_pose("odom_from_robot", self.odom_from_robot, in_one_turn=False)
        if self.stamp_ns is not None and not isinstance(self.stamp_ns, int | np.integer):
            raise ValueError(f"stamp_ns is {self.stamp_ns!r}: give whole nanoseconds")
        if self.robot_from_laser is not None:
            checked_pose("robot_from_laser", self.robot_from_laser)
        if self.ranges is not None:
            self._check_scan(np.shape(self.ranges))

    def _check_scan(self, shape: tuple[int, ...]) -> None:
        beams = shape[0] if len(shape) == 1 else 0
        if not 0 < beams <= MAX_BEAMS:
            raise ValueError(f"ranges have shape {shape}, expected (B,) with 1 to {MAX_BEAMS}")
        if not self.range_max > 0.0:
            raise ValueError(f"range_max is {self.range_max}: give the laser's maximum range [m]")
        if not self.range_min < self.range_max:
            problem = f"range_min is {self.range_min}, range_max {self.range_max}"
            raise ValueError(f"{problem}: a range lies between them")
        check_angle("angle_min", self.angle_min)
        check_angle(f"angle_step times {beams - 1}", self.angle_step * (beams - 1) / 1.01)
        if beams > 1 and self.angle_step == 0.0:
            raise ValueError(f"angle_step is 0, but there are {beams} ranges")

    def __repr__(self) -> str:
        parts = [f"stamp_ns {self.stamp_ns}"] if self.stamp_ns is not None else []
        if self.odom_from_robot is not None:
            x, y, heading = self.odom_from_robot
            parts.append(f"odometry ({x:.2f} m, {y:.2f} m, {heading:.2f} rad)")
        if self.ranges is not None:
            values = np.asarray(self.ranges, np.float64)
            finite = values[np.isfinite(values)]
            between = f" of {finite.min():.2f} to {finite.max():.2f} m" if finite.size else ""
            parts.append(f"{len(values)} ranges{between}")
            parts.append(f"range_max {self.range_max:g} m")
        return f"<Reading: {', '.join(parts)}>"

    def as_message(
        self, stamp_ns: int, robot_from_laser: PoseTuple
    ) -> LaserReading | OdometryReading:
        """Convert the reading to a message."""
        odometry = None
        if self.odom_from_robot is not None:
            x, y, heading = map(float, self.odom_from_robot)
            odometry = (x, y, heading)
        stamp_ns = stamp_ns if self.stamp_ns is None else int(self.stamp_ns)
        if self.ranges is None:
            assert odometry is not None  # ensured by __post_init__
            return OdometryReading(sender=_SENDER, stamp_ns=stamp_ns, odom_from_robot=odometry)
        return LaserReading(
            sender=_SENDER,
            stamp_ns=stamp_ns,
            ranges=ArrayBlob.of(np.asarray(self.ranges), "float32"),
            robot_from_laser=self.robot_from_laser or robot_from_laser,
            odom_from_robot=odometry,
            **{theirs: getattr(self, ours) for ours, theirs in _NAMES.items()},
        )

    @staticmethod
    def of(message: LaserReading | OdometryReading) -> Reading:
        """Return the reading of a message; a recorded one may hold anything."""
        if isinstance(message, OdometryReading):
            return _Recorded(message.odom_from_robot, stamp_ns=message.stamp_ns)
        return _Recorded(
            message.odom_from_robot,
            message.ranges.array(),
            stamp_ns=message.stamp_ns,
            robot_from_laser=message.robot_from_laser,
            **{ours: getattr(message, theirs) for ours, theirs in _NAMES.items()},
        )


class _Recorded(Reading):
    """A reading of a recording: unusable ones are counted, so that the others are used."""

    def __post_init__(self) -> None:
        pass


def read_recording(
    path: Path | str,
    *,
    robot_from_laser: PoseTuple = (0.0, 0.0, 0.0),
    scan_topic: str = "",
    odom_topic: str = "",
    odom_frame: str = "",
    base_frame: str = "",
) -> Iterator[Reading]:
    """Return all readings of a recording in the order of time.

    The recording is a ROS bag, a CARMEN log, or a flight recording. Malformed lines are skipped,
    with a warning in the log.

    Args:
        path: a file, which may be compressed by gzip or xz, or the folder of a rosbag2.
        robot_from_laser: mount of the laser, for a recording without one: x [m], y [m],
            heading [rad].
        scan_topic: scan topic, for a bag with several.
        odom_topic: odometry topic of a bag, used instead of tf; empty: tf.
        odom_frame: odometry frame of a bag, if it is not ``odom``.
        base_frame: the robot's frame in a bag, if it is not the child of the odometry frame.

    Raises:
        RecordingError: the recording cannot be used.
    """
    from clustermcl.sensor_bridge.recorded import opened  # noqa: PLC0415 - loads all readers

    x_m, y_m, heading_rad = robot_from_laser
    settings = msgspec.structs.replace(
        Settings().bridge,
        laser_x_m=x_m,
        laser_y_m=y_m,
        laser_heading_rad=heading_rad,
        scan_topic=scan_topic,
        odom_topic=odom_topic,
        odom_frame=odom_frame,
        base_frame=base_frame,
    )
    return map(Reading.of, opened(str(path), settings).readings)
