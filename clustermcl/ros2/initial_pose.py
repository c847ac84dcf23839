"""Initial poses of the robot from ROS."""

import math
from contextlib import suppress
from typing import Any

import numpy as np

from clustermcl.filter.poses import between, compose
from clustermcl.protocol.answers import SetPose
from clustermcl.protocol.message import Covariance
from clustermcl.protocol.pose_arrays import covariance_tuple, pose_tuple
from clustermcl.protocol.validity import gaussian_problem
from clustermcl.recordings.headers import frame_name, time_of
from clustermcl.recordings.rigid import rigid_of
from clustermcl.recordings.transforms import TransformMissingError, TransformTree
from clustermcl.ros2.outputs import NO_ID, SENDER
from clustermcl.runtime.settings import Ros2Settings

_LEAST_M, _LEAST_RAD = 0.01, 0.005
"""Least standard deviations: senders that omit the covariance send zeros."""
_PLANAR = (0, 1, 5)


def given_pose(message: Any, settings: Ros2Settings, frames: TransformTree) -> SetPose:
    """Convert a `geometry_msgs/PoseWithCovarianceStamped` to the robot's current pose.

    The odometry since its stamp is added, if the tf buffer reaches back that far.

    Raises:
        ValueError: its frame is not that of the map, or its numbers are not a valid pose.
    """
    then, wide = pose_in_map(message, settings)
    covariance = _usable(wide)
    if problem := gaussian_problem(pose_tuple(then), covariance):
        raise ValueError(problem.replace("_", " "))
    odom, base = settings.odom_frame, settings.base_frame
    now_ns = frames.newest_ns(odom, base)
    stamp_ns = time_of(message.header.stamp)
    now = then
    if now_ns is not None and 0 < stamp_ns < now_ns:
        with suppress(TransformMissingError):
            start, end = (frames.lookup(odom, base, at).planar() for at in (stamp_ns, now_ns))
            now = compose(then, between(np.array(start), np.array(end)))
    return SetPose(
        sender=SENDER,
        command_id=NO_ID,
        pose=pose_tuple(now),
        covariance=covariance,
        stamp_ns=now_ns,
    )


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


def pose_in_map(message: Any, settings: Ros2Settings) -> tuple[Any, Any]:
    """Return the planar (3,) pose and (3, 3) covariance of a pose in the map's frame."""
    frame = frame_name(message.header.frame_id)
    if frame != settings.global_frame:
        raise ValueError(f"its frame is {frame!r}, not {settings.global_frame!r}")
    given = message.pose
    pose = np.array(rigid_of(given.pose.position, given.pose.orientation).planar())
    return pose, np.reshape(given.covariance, (6, 6))[np.ix_(_PLANAR, _PLANAR)]


def _usable(covariance: Any) -> Covariance:
    """Return a (3, 3) covariance made symmetric, with at least the least standard deviations."""
    spread = (covariance + covariance.T) / 2.0
    for axis, least in enumerate((_LEAST_M, _LEAST_M, _LEAST_RAD)):
        if spread[axis, axis] >= 0.0:  # the caller refuses a negative one
            spread[axis, axis] = max(spread[axis, axis], least**2)
    return covariance_tuple(spread)
