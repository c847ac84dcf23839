"""Robots that are not the simplest: several lasers, other sensors, a clock that is set back."""

import math
import time

import numpy as np
import pytest

from process_runtime.ros2_settings import Ros2Settings
from protocol.steps import LaserReading
from recordings.rigid import IDENTITY, Rigid, flat
from ros2_bridge import message_types as types
from ros2_bridge.message_types import new
from ros2_bridge.messages_out import header, pose_stamped
from ros2_bridge.topics import AMCL_POSE, CLOCK, DIAGNOSTICS
from tests.integration.ros2.conftest import ACTIVE, OpenRobot, OpenSystem, StartBridge
from tests.integration.ros2.robot import SCAN, RosRobot, laser_scan
from tests.integration.ros2.system_double import SystemDouble
from tests.integration.waiting import wait_until
from tests.unit.ros2_bridge.beliefs import COVARIANCE
from tests.unit.ros2_bridge.test_point_clouds import cloud

pytestmark = pytest.mark.usefixtures("router")

SECOND = 1_000_000_000
OVERHEAD = Rigid(0.1, 0.0, 1.2, 1.0, 0.0, 0.0, 0.0)
"""Turned about the robot's x axis: it hangs from the roof."""


def ends_in_robot(reading: LaserReading) -> np.ndarray:
    """(N, 2) where the beams end on the floor, seen from the robot [m]."""
    ranges = reading.ranges.array()
    angles = reading.angle_min_rad + reading.angle_step_rad * np.arange(len(ranges))
    x, y, heading = reading.robot_from_laser
    return np.column_stack(
        (x + ranges * np.cos(heading + angles), y + ranges * np.sin(heading + angles))
    )


def test_two_lasers_one_of_them_upside_down_keep_mounts_and_beam_order(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    robot, system = open_robot(), open_system()
    rear = (-0.3, 0.0, math.pi - 0.001)
    robot.put_mounts(("laser", flat((0.2, 0.1, 0.0))), ("rear", flat(rear)), ("roof", OVERHEAD))
    start_bridge(ACTIVE)
    for frame in ("laser", "rear", "roof"):
        robot.stand_until(lambda frame=frame: lasers(system, frame), frame=frame)  # type: ignore[misc] # as it is now
    front, behind, above = (lasers(system, frame)[-1] for frame in ("laser", "rear", "roof"))
    np.testing.assert_allclose(front.robot_from_laser, (0.2, 0.1, 0.0), atol=1e-9)
    np.testing.assert_allclose(behind.robot_from_laser, rear, atol=1e-9)
    assert above.angle_step_rad > 0.0
    # SCAN's first beam is the shortest, at -1 rad: to the right of a laser that stands upright.
    ranges, first = SCAN.ranges.array(), SCAN.angle_min_rad
    x, y = ranges[0] * math.cos(first), ranges[0] * math.sin(first)
    np.testing.assert_allclose(ends_in_robot(front)[0], (x + 0.2, y + 0.1), atol=1e-6)
    # Of the one that hangs it is to the left, and comes last.
    np.testing.assert_allclose(ends_in_robot(above)[-1], (x + 0.1, -y), atol=1e-6)


def test_several_topics_and_a_cloud_are_lasers_of_one_robot(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    settings = Ros2Settings(
        autostart=True, scan_topic="front/scan, rear/scan", pointcloud_topic="lidar/points"
    )
    robot, system = open_robot(settings), open_system()
    behind = flat((-0.3, 0.0, 3.0))
    robot.put_mounts(
        ("front", IDENTITY), ("rear", behind), ("lidar", Rigid(0.1, 0, 0.4, 0, 0, 0, 1))
    )
    start_bridge(settings)
    front, rear, points = robot.topics.scans

    def all_are_heard() -> bool:
        stamp_ns = time.time_ns()
        robot.put_odometry(stamp_ns, (0.0, 0.0, 0.0))
        robot.put(front, laser_scan(SCAN, "front", stamp_ns))
        robot.put(rear, laser_scan(SCAN, "rear", stamp_ns))
        robot.put(points, cloud([(2.0, 0.0, 0.1)], stamp_ns=stamp_ns))
        return {one.laser for one in list(system.lasers)} == {"front", "rear", "lidar/points"}

    wait_until(all_are_heard)
    (cut, *_) = lasers(system, "lidar/points")
    assert cut.ranges.array().min() == 2.0
    assert cut.robot_from_laser == (0.1, 0.0, 0.0)
    assert lasers(system, "rear")[0].robot_from_laser[0] == -0.3


def test_topics_of_poses_are_sources_of_observations(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    settings = Ros2Settings(autostart=True, pose_topics="uwb/pose, gnss/pose")
    robot, system = open_robot(settings), open_system()
    robot.put_mounts(("laser", IDENTITY))
    start_bridge(settings)

    def all_are_received() -> bool:
        for topic in robot.topics.poses:
            robot.put(topic, pose_stamped((1.0, 2.0, 0.5), COVARIANCE, time.time_ns(), "map"))
        return {one.sender for one in list(system.observations)} == {"uwb/pose", "gnss/pose"}

    wait_until(all_are_received)
    np.testing.assert_allclose(system.observations[0].mean, (1.0, 2.0, 0.5), atol=1e-12)


def lasers(system: SystemDouble, frame: str) -> list[LaserReading]:
    return [one for one in list(system.lasers) if one.laser == frame]


def say(robot: RosRobot, stamp_ns: int) -> None:
    """One moment of a simulated robot that stands."""
    robot.put(CLOCK, new(types.CLOCK, clock=header(stamp_ns, "").stamp))
    robot.put_odometry(stamp_ns, (1.0, 0.0, 0.0))
    robot.put_scan(SCAN, stamp_ns=stamp_ns)


def test_the_pose_follows_after_simulated_time_is_set_back(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    settings = Ros2Settings(autostart=True, use_sim_time=True)
    robot, system = open_robot(settings), open_system()
    robot.put_mounts(("laser", IDENTITY))
    bridge = start_bridge(settings)
    told, poses = robot.listen(DIAGNOSTICS), robot.listen(AMCL_POSE)
    tick = 1000 * SECOND
    for seconds in (-1, 2**31 - 1):
        no_time = new("builtin_interfaces/msg/Time", sec=seconds, nanosec=2 * SECOND)
        robot.put(CLOCK, new(types.CLOCK, clock=no_time))

    def go_on() -> list[LaserReading]:
        nonlocal tick
        tick += SECOND // 10
        say(robot, tick)
        return list(system.lasers)

    wait_until(go_on)
    system.believe(system.lasers[-1].stamp_ns, (1, 0.95, (5.0, 1.0, 0.0)), state="localized")
    wait_until(lambda: poses)
    wait_until(lambda: go_on() and told and told[-1].header.stamp.sec >= 1000)
    tick = 5 * SECOND  # the bag begins again
    wait_until(lambda: go_on()[-1].stamp_ns < 900 * SECOND)
    assert "clock set back" in bridge.err
    transforms, last = robot.listen(robot.topics.tf), system.lasers[-1]
    system.believe(last.stamp_ns, (1, 0.95, (7.0, 1.0, 0.0)), state="localized")
    wait_until(lambda: poses[-1].header.stamp.sec < 900)
    assert poses[-1].pose.pose.position.x == 7.0
    wait_until(lambda: go_on() and transforms)
    assert transforms[-1].transforms[0].header.stamp.sec < 900
    assert "clock refused" in bridge.err
    wait_until(lambda: go_on() and told[-1].header.stamp.sec < 900)
