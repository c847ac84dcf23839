"""Observations of other sensors, poses in the map and tags; and the encoder of particles."""

import math
from math import inf, nan
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.steps import Observation
from clustermcl.recordings.rigid import Rigid
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.messages_in import MOST_OBSERVATIONS
from clustermcl.ros2.messages_out import header, particle_cloud, pose_stamped, transform
from clustermcl.runtime.settings import Ros2Settings
from tests.ros_messages import decode, new, typestore
from tests.unit.ros2.ports import COVARIANCE, Refused
from tests.unit.ros2.test_amcl import PLACE, SECOND, Robot, causes

OPTICAL = Rigid(0.2, 0.0, 0.5, -0.5, 0.5, -0.5, 0.5)
"""Pose of a camera that looks ahead: its z axis is the robot's x axis."""


def wide(x: float, y: float, heading: float) -> Any:
    return np.diag([x, y, 0.0, 0.0, 0.0, heading]).ravel()


def observed(covariance: Any, stamp_ns: int = SECOND, frame: str = "map") -> Any:
    message = pose_stamped(PLACE, COVARIANCE, stamp_ns, frame)
    message.pose.covariance = covariance
    return message


def test_a_pose_by_another_sensor_is_an_observation_with_the_topic_as_source() -> None:
    (seen,) = Robot().observe(observed(wide(0.4, 0.5, 0.1)), "uwb/pose")
    assert isinstance(seen, Observation)
    assert (seen.sender, seen.stamp_ns, seen.landmark) == ("uwb/pose", SECOND, "")
    np.testing.assert_allclose(seen.mean, PLACE)
    assert seen.covariance == (0.4, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.1)


@pytest.mark.parametrize("heading", [0.0, -1.0, 1e6, nan])
def test_an_observed_pose_without_usable_heading_is_a_position(heading: float) -> None:
    (seen,) = Robot().observe(observed(wide(0.4, 0.5, heading)), "gnss")
    assert (len(seen.mean), seen.covariance) == (2, (0.4, 0.0, 0.0, 0.5))


@pytest.mark.parametrize(
    ("message", "problem"),
    [
        (observed(wide(0.0, 0.0, 0.0)), "a covariance that is not positive definite"),
        (observed(wide(nan, 1.0, 1.0)), "not all numbers are finite"),
        (observed(wide(1.0, inf, 1.0)), "not all numbers are finite"),
        (observed(wide(1e30, 1.0, 1.0)), "a covariance that is too large"),
        (observed(wide(1.0, 1.0, 1.0), frame="odom"), "its frame is 'odom', not 'map'"),
        (observed(wide(1.0, 1.0, 1.0), stamp_ns=0), "it has no stamp"),
    ],
)
def test_an_invalid_observed_pose_is_refused(message: Any, problem: str) -> None:
    (refused,) = Robot().observe(message, "gnss")
    assert refused.cause == "observation refused"
    assert refused.detail.startswith(f"gnss: {problem}")


def tags(*numbers: int, stamp_ns: int = SECOND) -> Any:
    kind = "apriltag_msgs/msg/AprilTagDetection"
    found = [new(kind, family="tag36h11", id=number) for number in numbers]
    return new(types.APRIL_TAGS, header=header(stamp_ns, "camera"), detections=found)


def with_camera() -> Robot:
    robot = Robot(Ros2Settings(tag_topics="tags"))
    robot.mount("camera", OPTICAL)
    return robot


def test_a_tag_is_a_landmark_with_the_name_of_its_frame_once_tf_has_it() -> None:
    robot = with_camera()
    assert robot.observe(tags(7), "tags") == []
    in_camera = transform((-0.5, 0.1, 0.0), SECOND, "camera", "tag36h11:7")
    in_camera.transforms[0].transform.translation.z = 3.0
    (one,) = robot.transforms(in_camera)
    assert (one.sender, one.landmark, one.stamp_ns) == ("tags", "tag36h11:7", SECOND)
    np.testing.assert_allclose(one.mean, (3.2, 0.5), atol=1e-12)
    sigma = 0.05 * math.hypot(3.2, 0.5, 0.4)
    np.testing.assert_allclose(one.covariance, np.diag([sigma**2] * 2).ravel())
    assert robot.wait(9 * SECOND) == []


def test_a_tag_without_transform_is_refused_and_a_flood_is_bounded() -> None:
    robot = with_camera()
    assert robot.observe(tags(7), "tags") == []
    missing = "observation without transform: frames not connected"
    assert causes(robot.wait(2 * SECOND)) == [missing]
    flood = robot.observe(tags(*range(MOST_OBSERVATIONS + 5)), "tags")
    assert causes(flood) == ["observation without transform: too many wait"] * 5
    robot.amcl.deactivate()
    assert robot.wait(9 * SECOND) == []
    (refused,) = with_camera().observe(tags(7, stamp_ns=0), "tags")
    assert refused == Refused("observation refused", "tags: it has no stamp")


@given(
    count=st.integers(0, 5), frame=st.text(max_size=9), stamp_ns=st.integers(0, 2**31 * 10**9 - 1)
)
def test_the_fast_cloud_has_the_bytes_of_the_general_encoder(
    count: int, frame: str, stamp_ns: int
) -> None:
    rng = np.random.default_rng(3)
    poses, weights = rng.normal(size=(count, 3)), rng.random(count)
    data = particle_cloud(poses, weights, stamp_ns, frame)
    cloud = decode(data, types.PARTICLE_CLOUD)
    assert bytes(typestore().serialize_cdr(cloud, types.PARTICLE_CLOUD)) == data
    assert cloud.header.frame_id == frame
    assert cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec == stamp_ns
    for particle, pose, weight in zip(cloud.particles, poses, weights, strict=True):
        turn = particle.pose.orientation
        assert (particle.pose.position.x, particle.pose.position.y) == (pose[0], pose[1])
        assert particle.weight == weight
        heading = 2.0 * np.arctan2(turn.z, turn.w)
        assert np.isclose(np.remainder(heading - pose[2] + np.pi, 2 * np.pi), np.pi)
