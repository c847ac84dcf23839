"""Initial poses: given by topic, by service and by parameters; good and bad."""

import math

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from diagnostic_msgs.msg import DiagnosticArray
from nav2_msgs.srv import SetInitialPose

from tests.integration.ros.conftest import StartDrive
from tests.integration.ros.robot import pose_at_start, pose_message
from tests.integration.waiting import wait_until


def test_bad_poses_are_refused_and_the_stamp_of_a_good_one_counts(start_drive: StartDrive) -> None:
    drive = start_drive()
    robot = drive.robot
    diagnostics = robot.listen("/diagnostics", DiagnosticArray)
    [stamp] = drive.drive(1)
    truth = drive.truth[stamp]
    for frame in ("odom", ""):
        robot.put_initial_pose(truth, frame=frame)
    robot.put_initial_pose((math.nan, 0.0, 0.0))
    robot.put_initial_pose((math.inf, 0.0, 0.0))
    robot.put_initial_pose(truth, sigma=math.nan)
    no_turn = pose_message(truth)
    no_turn.pose.pose.orientation.w = no_turn.pose.pose.orientation.z = 0.0
    robot.put("initialpose", no_turn)
    robot.call("set_initial_pose", SetInitialPose, pose=pose_message((1e300, 0.0, 0.0)))

    def refused() -> int:
        values = diagnostics[-1].status[0].values if diagnostics else ()
        return sum(int(one.value) for one in values if "pose" in one.key)

    wait_until(lambda: refused() >= 6, 20.0)
    stamps = drive.drive(15, within_s=0.05)
    assert not drive.poses
    old = stamps[2]  # the robot has moved since
    given = pose_message(drive.truth[old], stamp_ns=old, sigma=0.1)
    robot.call("set_initial_pose", SetInitialPose, pose=given)
    drive.drive_until(lambda: drive.poses)
    assert drive.error(0)[0] < 0.3
    drive.drive(10)
    assert drive.error()[0] < 0.2
    assert drive.node.is_running()


def test_a_given_pose_replaces_the_belief(start_drive: StartDrive) -> None:
    drive = start_drive(parameters={"set_initial_pose": True, **pose_at_start()})
    drive.drive_until(lambda: drive.poses)
    [stamp] = drive.drive(1)
    x, y, heading = drive.truth[stamp]
    behind = x - 1.5 * math.cos(heading), y - 1.5 * math.sin(heading), heading  # it came from there
    drive.robot.put_initial_pose(behind, stamp_ns=stamp, sigma=0.05)
    drive.drive_until(lambda: drive.error()[0] > 0.8)
