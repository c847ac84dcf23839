"""Convert laser scans and point clouds of ROS to readings, once their transforms are known.

As in AMCL, odometry and the laser's pose are those of tf at the scan's stamp, ranges below
`range_min` are no return, a laser may be upside down, and several may share one topic. A slice of a
point cloud becomes a scan as in pointcloud_to_laserscan.
"""

import math
from collections import deque
from dataclasses import dataclass
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process_runtime.ros2_settings import Ros2Settings
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.reading_checks import laser_problem
from protocol.steps import LaserReading
from recordings.headers import frame_name, stamp_of
from recordings.laser_mount import counter_clockwise
from recordings.rigid import Rigid
from recordings.transforms import TransformMissingError, TransformTree
from ros2_bridge.message_types import POINT_CLOUD
from ros2_bridge.outputs import Refused

MAX_WAITING = 10
"""Limit for the scans of one laser that wait for tf, as in AMCL."""


@dataclass(eq=False)
class _Waiting:
    scan: Any
    frame: str
    stamp_ns: int
    since_ns: int


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
            scan: a `sensor_msgs/LaserScan` or `PointCloud2`.
            now_ns: time on a monotonic clock.

        Raises:
            ValueError: its stamp is not a valid ROS time.
        """
        waiting = _Waiting(scan, frame_name(scan.header.frame_id), stamp_of(scan.header), now_ns)
        self._waiting.append(waiting)
        of_laser = [one for one in self._waiting if one.frame == waiting.frame]
        if len(of_laser) <= MAX_WAITING:
            return []
        self._waiting.remove(of_laser[0])
        return [self._refused(of_laser[0], self._missing(of_laser[0]), now_ns)]

    def ready(self, now_ns: int) -> list[LaserReading | Refused]:
        """Remove scans whose transforms are known or late; return their readings or refusals."""
        done: list[LaserReading | Refused] = []
        still: deque[_Waiting] = deque()
        for waiting in self._waiting:
            try:
                done.append(self._reading(waiting))
                self._missing_since_ns.pop(waiting.frame, None)
            except TransformMissingError as missing:
                self._missing_since_ns.setdefault(waiting.frame, waiting.since_ns)
                tolerance_ns = self.settings.transform_tolerance_s * 1e9
                if missing.may_come and now_ns - waiting.since_ns < tolerance_ns:
                    still.append(waiting)
                else:
                    done.append(self._refused(waiting, missing, now_ns))
            except ValueError as problem:
                done.append(Refused("laser scan refused", str(problem)))
        self._waiting = still
        return done

    def _reading(self, waiting: _Waiting) -> LaserReading:
        settings, stamp_ns = self.settings, waiting.stamp_ns
        odom_from_base = self._frames.lookup(settings.odom_frame, settings.base_frame, stamp_ns)
        base_from_laser = self._frames.lookup(settings.base_frame, waiting.frame, stamp_ns)
        is_cloud = waiting.scan.__msgtype__ == POINT_CLOUD
        made = cloud_reading if is_cloud else laser_reading
        reading = made(waiting.scan, base_from_laser, odom_from_base.planar(), settings)
        if problem := laser_problem(reading):
            raise ValueError(f"{waiting.frame!r}: {problem.replace('_', ' ')}")
        return reading

    def _missing(self, waiting: _Waiting) -> TransformMissingError:
        try:
            self._reading(waiting)
        except TransformMissingError as missing:
            return missing
        except ValueError:
            pass
        return TransformMissingError("arrived too late", cause="too many scans", may_come=False)

    def _refused(self, waiting: _Waiting, missing: TransformMissingError, now_ns: int) -> Refused:
        since_ns = self._missing_since_ns.get(waiting.frame, waiting.since_ns)
        waited = f"waited for {(now_ns - since_ns) / 1e9:.1f} s"
        return Refused(
            f"laser scan without transform: {missing.cause}",
            f"laser {waiting.frame!r}, {waited}: {missing}",
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


BEAMS = 720
RANGE_MAX_M = 100.0
"""Assumed maximum range; a point cloud message does not have it."""
_FORMATS = {7: "f4", 8: "f8"}
"""By ROS's numbers of data types."""


def cloud_reading(
    cloud: Any, base_from_sensor: Rigid, odom_from_robot: PoseTuple, settings: Ros2Settings
) -> LaserReading:
    """Take the nearest point in each direction, between two heights above the base frame.

    Args:
        cloud: a `sensor_msgs/PointCloud2`.
        base_from_sensor: pose of the sensor on the robot.
        odom_from_robot: odometry at the cloud's stamp.
        settings: the heights [m], shortest and longest range, and the sender's name.

    Raises:
        ValueError: the cloud has no points, no x, y or z, or inconsistent sizes.
    """
    axes, rotation = _axes(cloud), base_from_sensor.rotation()
    with np.errstate(invalid="ignore", over="ignore"):  # NaN stands for no point
        heights = sum(map(mul, rotation[2].tolist(), axes), base_from_sensor.z)
        kept = (heights >= settings.min_height_m) & (heights <= settings.max_height_m)
    # Seen from above with the sensor at the origin, so that ranges are along its lines of sight.
    points = np.array([axis[kept] for axis in axes], np.float64)
    x, y = rotation[:2] @ points[:, np.isfinite(points).all(axis=0)]
    ranges, angles = np.hypot(x, y), np.arctan2(y, x)
    longest_m = settings.laser_max_range_m if settings.laser_max_range_m > 0.0 else RANGE_MAX_M
    used = (ranges >= max(settings.laser_min_range_m, 0.0)) & (ranges < longest_m)
    step_rad = 2.0 * math.pi / BEAMS
    beams = ((angles[used] + math.pi) / step_rad).astype(np.int64) % BEAMS
    nearest = np.full(BEAMS, np.inf)
    np.minimum.at(nearest, beams, ranges[used])
    return LaserReading(
        sender=settings.node_name,
        stamp_ns=stamp_of(cloud.header),
        ranges=ArrayBlob.of(nearest, "float32"),
        angle_min_rad=-math.pi + step_rad / 2.0,
        angle_step_rad=step_rad,
        range_max_m=longest_m,
        robot_from_laser=(base_from_sensor.x, base_from_sensor.y, 0.0),
        odom_from_robot=odom_from_robot,
        laser=f"{frame_name(cloud.header.frame_id)}/points",
    )


def _axes(cloud: Any) -> list[NDArray[np.floating]]:
    """Return x, y and z of all points in the sensor's frame, as three (N,) arrays [m]."""
    fields = {field.name: field for field in cloud.fields}
    places, order = {}, ">" if cloud.is_bigendian else "<"
    for name in ("x", "y", "z"):
        field = fields.get(name)
        if field is None or field.datatype not in _FORMATS:
            raise ValueError(f"a cloud without {name} as float32 or float64")
        places[name] = (np.dtype(order + _FORMATS[field.datatype]), int(field.offset))
    rows, cols = int(cloud.height), int(cloud.width)
    point, row = int(cloud.point_step), int(cloud.row_step)
    if not rows * cols:
        raise ValueError("a cloud without points")
    fits = all(offset + kind.itemsize <= point for kind, offset in places.values())
    if not (fits and cols * point <= row and rows * row <= len(cloud.data)):
        size = f"{rows} x {cols} points of {point} bytes in rows of {row}"
        raise ValueError(f"a cloud of {size} does not fit into {len(cloud.data)} bytes")
    return [
        np.ndarray((rows, cols), kind, cloud.data, offset, (row, point)).ravel()
        for kind, offset in places.values()
    ]
