"""Readings of a robot as numpy arrays, and an iterator over the readings of a recording."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, OdometryReading
from clustermcl.runtime.settings import Settings

_SENDER = "library"


@dataclass(frozen=True, eq=False)
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
        ValueError: there is neither a scan nor odometry, or an array has the wrong shape.
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
        if self.ranges is not None and np.ndim(self.ranges) != 1:
            raise ValueError(f"ranges have shape {np.shape(self.ranges)}, expected (B,)")
        if self.odom_from_robot is not None and len(self.odom_from_robot) != 3:
            raise ValueError(f"odom_from_robot is x, y, heading, not {self.odom_from_robot}")

    def as_message(
        self, stamp_ns: int, robot_from_laser: PoseTuple
    ) -> LaserReading | OdometryReading:
        """Convert the reading to a message."""
        odometry = None
        if self.odom_from_robot is not None:
            x, y, heading = map(float, self.odom_from_robot)
            odometry = (x, y, heading)
        stamp_ns = stamp_ns if self.stamp_ns is None else self.stamp_ns
        if self.ranges is None:
            assert odometry is not None  # ensured by __post_init__
            return OdometryReading(sender=_SENDER, stamp_ns=stamp_ns, odom_from_robot=odometry)
        return LaserReading(
            sender=_SENDER,
            stamp_ns=stamp_ns,
            ranges=ArrayBlob.of(np.asarray(self.ranges), "float32"),
            angle_min_rad=self.angle_min,
            angle_step_rad=self.angle_step,
            range_max_m=self.range_max,
            range_min_m=self.range_min,
            robot_from_laser=self.robot_from_laser or robot_from_laser,
            odom_from_robot=odometry,
            laser=self.laser,
            upside_down=self.upside_down,
        )

    @classmethod
    def of(cls, message: LaserReading | OdometryReading) -> "Reading":
        if isinstance(message, OdometryReading):
            return cls(message.odom_from_robot, stamp_ns=message.stamp_ns)
        return cls(
            message.odom_from_robot,
            message.ranges.array(),
            angle_min=message.angle_min_rad,
            angle_step=message.angle_step_rad,
            range_max=message.range_max_m,
            range_min=message.range_min_m,
            stamp_ns=message.stamp_ns,
            robot_from_laser=message.robot_from_laser,
            laser=message.laser,
            upside_down=message.upside_down,
        )


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

    The recording is a ROS bag, a CARMEN log, a file of `clustermcl record`, or has a
    format with an installed or registered reader (see `register`). Malformed lines are skipped,
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
