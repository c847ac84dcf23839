"""What a robot measures, as the library takes it: numpy arrays, from anywhere or a recording."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evaluation.recordings import opened
from process_runtime.settings import Settings
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.steps import LaserReading, OdometryReading

_SENDER = "library"


@dataclass(frozen=True, eq=False)
class Reading:
    """One scan with its odometry, or one of the two alone.

    A scan without odometry gets that of its time, between the readings before and after it.

    Args:
        odom_from_robot: x [m], y [m], heading [rad] by odometry; None: not known at this time.
        ranges: (B,) [m], counter-clockwise; not finite, <= 0 or >= `range_max`: no return. None:
            odometry alone.
        angle_min: direction of the first beam in the laser's frame [rad].
        angle_step: from each beam to the next [rad].
        range_max: how far the laser sees [m].
        range_min: a reading below it is no return [m].
        stamp_ns: robot's clock. None: a second after the reading before; only the speed at which
            odometry counts as a jump depends on it.
        robot_from_laser: where the laser is on the robot: x [m], y [m], heading [rad]. None: that
            of `ClusterMCL`.
        laser: which one, where the robot has several.
        upside_down: the laser is mounted on its head, so its beams go clockwise.

    Raises:
        ValueError: there is neither scan nor odometry, or ranges have another shape than (B,).
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
        """The reading as a robot publishes it; the arguments stand in for what it leaves open."""
        odometry = None
        if self.odom_from_robot is not None:
            x, y, heading = map(float, self.odom_from_robot)
            odometry = (x, y, heading)
        stamp_ns = stamp_ns if self.stamp_ns is None else self.stamp_ns
        if self.ranges is None:
            assert odometry is not None  # or it would not have been made
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
        """A reading as a robot published it."""
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
    """All readings of a ROS bag, a CARMEN log or a Wean Hall log, in the order of time.

    Also what an installed or registered reader can read (`register`).
    Bad lines are left out, and named in a warning of the log.

    Args:
        path: the file, perhaps packed by gzip or xz, or the folder of a rosbag2.
        robot_from_laser: where the laser is, if the recording does not say: x, y [m], heading
            [rad].
        scan_topic: of a bag with several lasers.
        odom_topic: of a bag whose odometry is not to be taken from tf.
        odom_frame: of a bag, where it is not ``odom``.
        base_frame: the robot's, of a bag, where it is not ``base_footprint`` or ``base_link``.

    Raises:
        RecordingError: it cannot be used.
    """
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
