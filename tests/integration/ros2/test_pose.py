"""From a robot's scans to AMCL's pose and back to the robot's tf."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from particle_filter.poses import compose, inverse
from process_runtime.ros2_settings import Ros2Settings
from recordings.rigid import flat
from ros2_bridge.topics import AMCL_POSE
from tests.integration.ros2.conftest import OpenRobot, StartBridge
from tests.integration.ros2.robot import SCAN, planar
from tests.integration.ros2.system_double import SystemDouble
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.usefixtures("router")

ACTIVE = Ros2Settings(autostart=True)
OpenSystem = Callable[..., SystemDouble]


def test_scans_go_in_and_the_pose_comes_out(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    system, robot = open_system(), open_robot()
    robot.put_mounts(("laser", flat((0.2, 0.1, 0.5))))
    start_bridge(ACTIVE)
    stamp_ns, odometry = time.time_ns(), (1.0, 2.0, 0.3)
    robot.stand_until(lambda: system.lasers, odometry)
    laser = system.lasers[-1]
    np.testing.assert_allclose(laser.robot_from_laser, (0.2, 0.1, 0.5), atol=1e-12)
    np.testing.assert_allclose(laser.odom_from_robot or (), odometry, atol=1e-12)
    assert laser.stamp_ns >= stamp_ns
    np.testing.assert_array_equal(laser.ranges.array(), SCAN.ranges.array())
    poses, transforms = robot.listen(AMCL_POSE), robot.listen(robot.topics.tf)
    place = (5.0, -3.0, 1.0)
    system.believe(laser.stamp_ns, (7, 0.95, place), state="localized")
    wait_until(lambda: poses)
    told = poses[-1]
    np.testing.assert_allclose(planar(told.pose.pose), place, atol=1e-12)
    assert told.header.frame_id == "map"
    assert (told.header.stamp.sec, told.header.stamp.nanosec) == divmod(laser.stamp_ns, 10**9)
    assert (told.pose.covariance[0], told.pose.covariance[35]) == (0.04, 0.02)
    robot.stand_until(lambda: transforms, odometry)
    sent = transforms[-1].transforms[0]
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "odom")
    expected = compose(np.array(place), inverse(np.array(odometry)))
    np.testing.assert_allclose(planar(sent.transform), expected, atol=1e-12)
