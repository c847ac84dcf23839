"""Initial poses: given by topic, by service and by parameters; good and bad."""

import math

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav2_msgs.srv import SetInitialPose

from tests.integration.ros.conftest import OpenRobot, StartNode
from tests.integration.ros.robot import LATCHED, Drive, pose_message
from tests.integration.waiting import wait_until

ACTIVE = {"autostart_node": True}


def test_bad_poses_are_refused_and_a_good_one_is_used(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    node = start_node(parameters=ACTIVE)
    robot = open_robot()
    drive = Drive(robot)
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    diagnostics = robot.listen("/diagnostics", DiagnosticArray)
    drive.begin()
    [stamp] = drive.drive(1)
    truth = drive.truth[stamp]
    for frame in ("odom", ""):
        robot.put_initial_pose(truth, frame=frame)
    robot.put_initial_pose((math.nan, 0.0, 0.0))
    robot.put_initial_pose((math.inf, 0.0, 0.0))
    robot.put_initial_pose(truth, sigma=math.nan)
    no_turn = pose_message(truth)
    no_turn.pose.pose.orientation.w = no_turn.pose.pose.orientation.z = 0.0
    robot.publisher("initialpose", PoseWithCovarianceStamped).publish(no_turn)
    robot.call("set_initial_pose", SetInitialPose, pose=pose_message((1e300, 0.0, 0.0)))

    def refused() -> int:
        if not diagnostics:
            return 0
        values = {one.key: one.value for one in diagnostics[-1].status[0].values}
        return sum(int(value) for key, value in values.items() if "pose" in key)

    wait_until(lambda: refused() >= 6, 20.0)
    drive.drive(5)
    assert not poses
    robot.put_initial_pose(truth)
    drive.drive_until(lambda: poses)
    drive.drive(10)
    assert drive.error(poses[-1])[0] < 0.2
    assert node.is_running()


def test_the_service_sets_the_pose_and_a_stamp_in_the_past_counts(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    start_node(parameters=ACTIVE)
    robot = open_robot()
    drive = Drive(robot)
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    drive.begin()
    stamps = drive.drive(15, within_s=0.05)
    old = stamps[2]  # the robot has moved since
    given = pose_message(drive.truth[old], stamp_ns=old, sigma=0.1)
    robot.call("set_initial_pose", SetInitialPose, pose=given)
    drive.drive_until(lambda: poses)
    assert drive.error(poses[0])[0] < 0.3


def test_a_given_pose_replaces_the_belief(start_node: StartNode, open_robot: OpenRobot) -> None:
    robot = open_robot()
    drive = Drive(robot)
    x, y, heading = drive.simulation.map_from_robot
    initial = {"initial_pose.x": x, "initial_pose.y": y, "initial_pose.yaw": heading}
    start_node(parameters={**ACTIVE, "set_initial_pose": True, **initial})
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    drive.begin()
    drive.drive_until(lambda: poses)
    [stamp] = drive.drive(1)
    x, y, heading = drive.truth[stamp]
    behind = (
        x - 1.5 * math.cos(heading),
        y - 1.5 * math.sin(heading),
        heading,
    )  # it came from there
    robot.put_initial_pose(behind, stamp_ns=stamp, sigma=0.05)
    drive.drive_until(lambda: drive.error(poses[-1])[0] > 0.8)
