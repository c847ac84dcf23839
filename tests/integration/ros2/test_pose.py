"""From a robot's scans to AMCL's pose and back to the robot's tf."""

import time
from collections.abc import Callable

import numpy as np
import pytest

from particle_filter.poses import compose, inverse
from process_runtime.ros2_settings import Ros2Settings
from protocol.arrays import ArrayBlob
from protocol.message import PoseTuple
from protocol.pose_arrays import pose_tuple
from protocol.steps import LaserReading
from ros2_bridge.rigid import flat
from ros2_bridge.topics import AMCL_POSE
from tests.integration.ros2.conftest import OpenRobot, StartBridge
from tests.integration.ros2.robot import RosRobot, planar
from tests.integration.ros2.system_double import SystemDouble
from tests.integration.waiting import wait_until

pytestmark = pytest.mark.usefixtures("router")

ACTIVE = Ros2Settings(autostart=True)
OpenSystem = Callable[..., SystemDouble]


def reading(beams: int = 9) -> LaserReading:
    return LaserReading(
        sender="test",
        stamp_ns=0,
        ranges=ArrayBlob.of(np.linspace(1.0, 3.0, beams), "float32"),
        angle_min_rad=-1.0,
        angle_step_rad=0.25,
        range_max_m=10.0,
        robot_from_laser=(0.0, 0.0, 0.0),
    )


def scan_at(robot: RosRobot, stamp_ns: int, odometry: PoseTuple) -> None:
    robot.put_odometry(stamp_ns, odometry)
    robot.put_scan(reading(), stamp_ns=stamp_ns)


def test_scans_go_in_and_the_pose_comes_out(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    system, robot = open_system(), open_robot()
    robot.put_mounts(("laser", flat((0.2, 0.1, 0.5))))
    start_bridge(ACTIVE)
    stamp_ns = time.time_ns()
    wait_until(lambda: scan_at(robot, time.time_ns(), (1.0, 2.0, 0.3)) or system.lasers)
    laser = system.lasers[-1]
    np.testing.assert_allclose(laser.robot_from_laser, (0.2, 0.1, 0.5), atol=1e-12)
    np.testing.assert_allclose(laser.odom_from_robot or (), (1.0, 2.0, 0.3), atol=1e-12)
    assert laser.stamp_ns >= stamp_ns
    np.testing.assert_array_equal(laser.ranges.array(), reading().ranges.array())
    poses, transforms = robot.listen(AMCL_POSE), robot.listen(robot.topics.tf)
    place = (5.0, -3.0, 1.0)
    system.believe(laser.stamp_ns, (7, 0.95, place), state="localized")
    wait_until(lambda: poses)
    told = poses[-1]
    np.testing.assert_allclose(planar(told.pose.pose), place, atol=1e-12)
    assert told.header.frame_id == "map"
    assert (told.header.stamp.sec, told.header.stamp.nanosec) == divmod(laser.stamp_ns, 10**9)
    assert (told.pose.covariance[0], told.pose.covariance[35]) == (0.01, 0.005)
    scan_at(robot, time.time_ns(), (1.0, 2.0, 0.3))
    wait_until(lambda: transforms)
    sent = transforms[-1].transforms[0]
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "odom")
    expected = compose(np.array(place), inverse(np.array((1.0, 2.0, 0.3))))
    np.testing.assert_allclose(planar(sent.transform), pose_tuple(expected), atol=1e-12)
