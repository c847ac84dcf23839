"""Convert a slice of a point cloud to a laser scan, like pointcloud_to_laserscan."""

import math
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

from process_runtime.ros2_settings import Ros2Settings
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.steps import LaserReading
from recordings.rigid import Rigid
from ros2_bridge.headers import frame_name, stamp_of

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
    """Three (N,) arrays: x, y and z of all points in the sensor's frame.

    Raises:
        ValueError: as in `cloud_reading`.
    """
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
