"""The ROS messages that the node reads: scans, initial poses, and observations of other sensors.

As in AMCL, odometry and the laser's pose are those of tf at the scan's stamp, ranges below
`range_min` are no return, a laser may be upside down, and several may share one topic.
"""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from clustermcl.filter.poses import between, compose
from clustermcl.protocol.answers import SetPose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import key_of
from clustermcl.protocol.message import MAX_ID_CHARACTERS, Covariance
from clustermcl.protocol.pose_arrays import covariance_tuple, pose_tuple
from clustermcl.protocol.reading_checks import laser_problem, numbers_of, observation_problem
from clustermcl.protocol.steps import LaserReading, Observation
from clustermcl.protocol.validity import gaussian_problem
from clustermcl.recordings.headers import frame_name, time_of
from clustermcl.recordings.rigid import is_upside_down, rigid_of
from clustermcl.recordings.transforms import TransformMissingError, TransformTree
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.sides import NO_ID, SENDER
from clustermcl.ros2.topics import Topic
from clustermcl.runtime.settings import Ros2Settings

MOST_SCANS, MOST_OBSERVATIONS = 10, 100
"""Limits for the messages of one laser, as in AMCL, and of one topic that wait for tf."""
_KNOWN_RAD = math.pi / 2.0
"""An observation with a larger standard deviation of its heading is used without it."""
_LEAST_TAG_M = 0.02
_LEAST_M, _LEAST_RAD = 0.01, 0.005
"""Least standard deviations: senders that omit the covariance send zeros."""
_PLANAR = (0, 1, 5)


class MessagesIn:
    """Converts messages with the transforms of their time.

    Methods raise a `TransformMissingError` if tf does not have the robot or the sensor then, and a
    `ValueError` if the message has no stamp, a wrong frame, or numbers that are not valid.
    """

    def __init__(self, frames: TransformTree, settings: Ros2Settings) -> None:
        self.settings, self._frames = settings, frames

    def laser_reading(self, scan: Any) -> LaserReading:
        """Convert a `sensor_msgs/LaserScan`."""
        settings, frame = self.settings, frame_name(scan.header.frame_id)
        stamp_ns, longest_m = time_of(scan.header.stamp), settings.laser_max_range_m
        odom_from_base = self._frames.lookup(settings.odom_frame, settings.base_frame, stamp_ns)
        base_from_laser = self._frames.lookup(settings.base_frame, frame, stamp_ns)
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

    def given_pose(self, message: Any) -> SetPose:
        """Convert a `geometry_msgs/PoseWithCovarianceStamped` to the robot's current pose.

        The odometry since its stamp is added, if the tf buffer reaches back that far.
        """
        pose, wide = self._pose_in_map(message)
        covariance = _usable(wide)
        if problem := gaussian_problem(pose_tuple(pose), covariance):
            raise ValueError(problem.replace("_", " "))
        odom, base = self.settings.odom_frame, self.settings.base_frame
        now_ns, stamp_ns = self._frames.newest_ns(odom, base), time_of(message.header.stamp)
        if now_ns is not None and 0 < stamp_ns < now_ns:
            with suppress(TransformMissingError):
                moved = (self._frames.lookup(odom, base, at).planar() for at in (stamp_ns, now_ns))
                pose = compose(pose, between(*map(np.array, moved)))
        return SetPose(
            sender=SENDER,
            command_id=NO_ID,
            pose=pose_tuple(pose),
            covariance=covariance,
            stamp_ns=now_ns,
        )

    def observations(self, message: Any, of: Topic) -> Iterator[Callable[[], Observation]]:
        """Yield a function for each observation in a message; its topic is the source."""
        if of.ros_type == types.POSE_STAMPED:
            yield partial(self._pose, message, of.name)
        else:
            for tag in message.detections:
                yield partial(self._tag, message, of.name, f"{tag.family}:{tag.id}")

    def _pose(self, message: Any, topic: str) -> Observation:
        pose, covariance = self._pose_in_map(message)
        known = 3 if 0.0 < covariance[2, 2] <= _KNOWN_RAD**2 else 2
        return _checked(message, topic, "", pose[:known], covariance[:known, :known])

    def _tag(self, message: Any, topic: str, name: str) -> Observation:
        """Return the position of a tag, whose frame in tf has its name."""
        at = self._frames.lookup(self.settings.base_frame, name, _stamp_of(message))
        distance_m = math.hypot(at.x, at.y, at.z)
        sigma_m = max(self.settings.sight_sigma_per_m * distance_m, _LEAST_TAG_M)
        return _checked(message, topic, name, np.array([at.x, at.y]), sigma_m**2 * np.eye(2))

    def _pose_in_map(self, message: Any) -> tuple[Any, Any]:
        """Return the planar (3,) pose and (3, 3) covariance of a pose in the map's frame."""
        frame = frame_name(message.header.frame_id)
        if frame != self.settings.global_frame:
            raise ValueError(f"its frame is {frame!r}, not {self.settings.global_frame!r}")
        given = message.pose
        pose = np.array(rigid_of(given.pose.position, given.pose.orientation).planar())
        return pose, np.reshape(given.covariance, (6, 6))[np.ix_(_PLANAR, _PLANAR)]


def initial_pose(settings: Ros2Settings) -> SetPose:
    """Return the pose in the settings, with AMCL's standard deviations."""
    return SetPose(
        sender=SENDER,
        command_id=NO_ID,
        pose=(settings.initial_x_m, settings.initial_y_m, settings.initial_heading_rad),
        position_sigma_m=0.5,
        heading_sigma_rad=math.pi / 12.0,
        floor=settings.initial_floor,
    )


def _usable(covariance: Any) -> Covariance:
    """Return a (3, 3) covariance made symmetric, with at least the least standard deviations."""
    spread = (covariance + covariance.T) / 2.0
    for axis, least in enumerate((_LEAST_M, _LEAST_M, _LEAST_RAD)):
        if spread[axis, axis] >= 0.0:  # the caller refuses a negative one
            spread[axis, axis] = max(spread[axis, axis], least**2)
    return covariance_tuple(spread)


def _stamp_of(message: Any) -> int:
    stamp_ns = time_of(message.header.stamp)
    if stamp_ns == 0:
        raise ValueError("it has no stamp")
    return stamp_ns


def _checked(message: Any, topic: str, name: str, mean: Any, covariance: Any) -> Observation:
    """Return an observation; a ValueError names what is missing or not valid in it."""
    seen = Observation(
        sender=topic[-MAX_ID_CHARACTERS:],
        stamp_ns=_stamp_of(message),
        landmark=name[:MAX_ID_CHARACTERS],
        mean=tuple(mean.tolist()),
        covariance=tuple(covariance.ravel().tolist()),
    )
    if not all(map(math.isfinite, (*seen.mean, *seen.covariance))):
        raise ValueError("not all numbers are finite")
    if problem := observation_problem(seen):
        raise ValueError(problem)
    return seen
