"""Convert laser scans of ROS to readings.

As in AMCL, odometry and the laser's pose are those of tf at the scan's stamp, ranges below
`range_min` are no return, a laser may be upside down, and several may share one topic.
"""

import math
from typing import Any

import numpy as np

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import key_of
from clustermcl.protocol.reading_checks import laser_problem, numbers_of
from clustermcl.protocol.steps import LaserReading
from clustermcl.recordings.headers import frame_name, time_of
from clustermcl.recordings.rigid import is_upside_down
from clustermcl.recordings.transforms import TransformTree
from clustermcl.ros2.outputs import SENDER
from clustermcl.runtime.settings import Ros2Settings

MAX_WAITING = 10
"""Limit for the scans of one laser that wait for tf, as in AMCL."""


def laser_reading(scan: Any, frames: TransformTree, settings: Ros2Settings) -> LaserReading:
    """Convert a `sensor_msgs/LaserScan`.

    Raises:
        TransformMissingError: tf does not have the robot or the laser at the scan's stamp.
        ValueError: the scan is malformed, the laser's plane is not horizontal, or the laser is
            not on the robot.
    """
    frame, stamp_ns = frame_name(scan.header.frame_id), time_of(scan.header.stamp)
    odom_from_base = frames.lookup(settings.odom_frame, settings.base_frame, stamp_ns)
    base_from_laser = frames.lookup(settings.base_frame, frame, stamp_ns)
    longest_m = settings.laser_max_range_m
    reading = LaserReading(
        sender=SENDER,
        stamp_ns=stamp_ns,
        ranges=ArrayBlob.of(np.asarray(scan.ranges), "float32"),
        angle_min_rad=float(scan.angle_min),
        angle_step_rad=float(scan.angle_increment),
        range_max_m=min(float(scan.range_max), longest_m if longest_m > 0.0 else math.inf),
        robot_from_laser=base_from_laser.planar(),
        odom_from_robot=odom_from_base.planar(),
        laser=frame,
        range_min_m=max(float(scan.range_min), settings.laser_min_range_m),
        upside_down=is_upside_down(frame, base_from_laser),
    )
    if problem := laser_problem(reading):
        raise ValueError(f"{key_of(problem).replace('_', ' ')}: {numbers_of(reading, problem)}")
    return reading
