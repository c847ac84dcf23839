"""From a robot's scan to AMCL's pose, over the middleware that ROS 2 has by default."""

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav2_msgs.msg import ParticleCloud
from std_msgs.msg import Float64, String
from vision_msgs.msg import Detection3D

from tests.integration.ros.conftest import OpenRobot, StartNode
from tests.integration.ros.robot import LATCHED, SENSOR, Drive, ns_of
from tests.integration.waiting import wait_until


def test_a_scan_gives_amcl_pose_and_every_scan_a_transform(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    start_node()
    robot = open_robot()
    drive = Drive(robot)
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    clouds = robot.listen("particle_cloud", ParticleCloud, SENSOR)
    robot.activate()
    drive.begin()
    first = drive.drive(1)
    assert not poses  # no pose is given, and several places look alike
    robot.put_initial_pose(drive.truth[first[0]])
    drive.drive_until(lambda: poses)
    stamps = drive.drive(30, within_s=5.0)
    assert [stamp for stamp in stamps if stamp not in drive.transforms] == []
    wait_until(lambda: clouds and ns_of(poses[-1].header.stamp) in stamps)
    metres, radians = drive.error(poses[-1])
    assert metres < 0.15
    assert radians < 0.05
    assert poses[-1].header.frame_id == clouds[-1].header.frame_id == "map"
    assert len(clouds[-1].particles) > 100
    assert abs(sum(one.weight for one in clouds[-1].particles) - 1.0) < 1e-3
    late = open_robot(name="late")
    latched = [
        late.listen(topic, kind, LATCHED)
        for topic, kind in (
            ("amcl_pose", PoseWithCovarianceStamped),
            ("amcl/state", String),
            ("amcl/probability", Float64),
            ("amcl/hypotheses/detection", Detection3D),
        )
    ]
    wait_until(lambda: all(latched))
    pose, state, probability, places = (received[-1] for received in latched)
    assert pose == poses[-1]
    assert state.data == "localized"
    assert probability.data > 0.9
    assert len(places.results) == 1


def test_without_a_given_pose_the_robot_is_found(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    start_node(parameters={"autostart_node": True})
    robot = open_robot()
    drive = Drive(robot)
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    states = robot.listen("amcl/state", String, LATCHED)
    drive.begin()
    drive.drive_until(lambda: states and states[-1].data == "localized")
    stamps = drive.drive(20)
    wait_until(lambda: ns_of(poses[-1].header.stamp) in stamps)
    assert drive.error(poses[-1])[0] < 0.2
