import time

import numpy as np
import pytest

from clustermcl.protocol.steps import LaserReading
from clustermcl.recordings.rigid import IDENTITY, flat
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import new
from clustermcl.ros2.messages_out import header, pose_stamped
from clustermcl.ros2.topics import AMCL_POSE, CLOCK, DIAGNOSTICS
from clustermcl.runtime.ros2_settings import Ros2Settings
from tests.integration.ros2.conftest import OpenRobot, OpenSystem, StartBridge
from tests.integration.ros2.robot import SCAN, RosRobot, laser_scan
from tests.integration.ros2.system_double import SystemDouble
from tests.integration.waiting import wait_until
from tests.unit.ros2.beliefs import COVARIANCE

pytestmark = pytest.mark.usefixtures("router")

SECOND = 1_000_000_000


def test_several_topics_and_poses_are_readings_of_one_robot(
    open_robot: OpenRobot, open_system: OpenSystem, start_bridge: StartBridge
) -> None:
    settings = Ros2Settings(
        autostart=True, scan_topic="front/scan, rear/scan", pose_topics="uwb/pose, gnss/pose",
    )  # fmt: skip
    robot, system = open_robot(settings), open_system()
    behind = flat((-0.3, 0.0, 3.0))
    robot.put_mounts(("front", IDENTITY), ("rear", behind))
    start_bridge(settings)
    front, rear = robot.topics.scans

    def all_have_arrived() -> bool:
        stamp_ns = time.time_ns()
        robot.put_odometry(stamp_ns, (0.0, 0.0, 0.0))
        robot.put(front, laser_scan(SCAN, "front", stamp_ns))
        robot.put(rear, laser_scan(SCAN, "rear", stamp_ns))
        for topic in robot.topics.observed:
            robot.put(topic, pose_stamped((1.0, 2.0, 0.5), COVARIANCE, stamp_ns, "map"))
        senders = {one.sender for one in list(system.observations)}
        frames = {one.laser for one in list(system.lasers)}
        return frames == {"front", "rear"} and senders == {"uwb/pose", "gnss/pose"}

    wait_until(all_have_arrived)
    assert lasers(system, "rear")[0].robot_from_laser[0] == -0.3
    np.testing.assert_allclose(system.observations[0].mean, (1.0, 2.0, 0.5), atol=1e-12)


def lasers(system: SystemDouble, frame: str) -> list[LaserReading]:
    return [one for one in list(system.lasers) if one.laser == frame]


def publish(robot: RosRobot, stamp_ns: int) -> None:
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
    diagnostics, poses = robot.listen(DIAGNOSTICS), robot.listen(AMCL_POSE)
    tick = 1000 * SECOND
    for seconds in (-1, 2**31 - 1):
        no_time = new("builtin_interfaces/msg/Time", sec=seconds, nanosec=2 * SECOND)
        robot.put(CLOCK, new(types.CLOCK, clock=no_time))

    def go_on() -> list[LaserReading]:
        nonlocal tick
        tick += SECOND // 10
        publish(robot, tick)
        return list(system.lasers)

    wait_until(go_on)
    system.believe(system.lasers[-1].stamp_ns, (1, 0.95, (5.0, 1.0, 0.0)), state="localized")
    wait_until(lambda: poses)
    wait_until(lambda: go_on() and diagnostics and diagnostics[-1].header.stamp.sec >= 1000)
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
    wait_until(lambda: go_on() and diagnostics[-1].header.stamp.sec < 900)
