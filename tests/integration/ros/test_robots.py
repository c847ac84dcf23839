"""Several robots, clocks, and sensors that name the place."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from apriltag_msgs.msg import AprilTagDetection, AprilTagDetectionArray
from std_msgs.msg import Float64
from tf2_msgs.msg import TFMessage

from clustermcl.filter.poses import between
from clustermcl.protocol.message import PoseTuple
from tests.integration.ros.conftest import StartDrive
from tests.integration.ros.robot import LATCHED, Drive, Robot, link, ns_of, pose_message, time_of
from tests.integration.waiting import wait_until

STARTS = ((5.0, 0.0, 0.0), (-5.0, 0.0, 0.0))
LANDMARK = (4.0, 1.0)
WITHIN_STEPS = 30
"""Without other sensors, the robot needs more to find its corridor."""


def test_two_robots_in_one_domain_do_not_disturb_each_other(start_drive: StartDrive) -> None:
    drives = [
        start_drive(namespace=f"/robot{number}", start=start) for number, start in enumerate(STARTS)
    ]
    for drive in drives:
        drive.localize()
    for drive in drives * 2:
        drive.drive(5)
    assert math.dist(*(d.truth[max(d.truth)][:2] for d in drives)) > 1.0
    for drive in drives:
        assert {ns_of(one.header.stamp) for one in drive.poses} <= drive.truth.keys()
        assert drive.error()[0] < 0.3
    assert not drives[0].robot.node.count_publishers("/tf")


def test_the_pose_follows_after_simulated_time_is_set_back(start_drive: StartDrive) -> None:
    again = {"zero_ns": 1000 * 10**9, "clocked": True}

    def follow(drive: Drive) -> int:
        [stamp] = drive.drive(1)
        drive.robot.put_initial_pose(drive.truth[stamp])
        drive.drive_until(lambda: drive.poses and drive.error()[0] < 0.3)
        drive.drive(60)
        wait_until(lambda: drive.posed_ns in list(drive.truth)[-60:])
        assert drive.error()[0] < 0.3
        return drive.posed_ns

    first = start_drive(parameters={"use_sim_time": True}, **again)
    last = follow(first)
    drive = Drive(first.robot, first.node, **again)
    drive.begin()
    drive.drive_until(lambda: "set back" in drive.node.err)  # the bag begins again
    drive.poses.clear()
    assert follow(drive) < last + 10 * 10**9
    assert drive.node.is_running()


def put_pose(robot: Robot, pose: PoseTuple, stamp_ns: int) -> None:
    robot.put("uwb/pose", pose_message(pose, stamp_ns=stamp_ns, sigma=0.1))


def put_tag(robot: Robot, pose: PoseTuple, stamp_ns: int) -> None:
    x, y, _ = between(pose, (*LANDMARK, 0.0))
    seen = link("base_footprint", "tag36h11:7", (float(x), float(y), 0.0), stamp_ns)
    robot.put("tf", TFMessage(transforms=[seen]), 100)
    message = AprilTagDetectionArray(detections=[AprilTagDetection(family="tag36h11", id=7)])
    message.header.frame_id, message.header.stamp = "base_footprint", time_of(stamp_ns)
    robot.put("tags", message)


@pytest.mark.parametrize(
    ("put", "parameters"),
    [(put_pose, {"ros2.pose_topics": "uwb/pose"}), (put_tag, {"ros2.tag_topics": "tags"})],
)
def test_a_sensor_that_names_the_place_localizes_the_robot_at_once(
    start_drive: StartDrive,
    tmp_path: Path,
    put: Callable[[Robot, PoseTuple, int], None],
    parameters: dict[str, str],
) -> None:
    x, y = LANDMARK
    landmarks = tmp_path / "landmarks.yaml"
    landmarks.write_text(f'landmarks:\n  - {{id: "tag36h11:7", x: {x}, y: {y}}}\n')
    drive = start_drive(parameters={"bridge.landmarks": str(landmarks), **parameters})
    beliefs = drive.robot.listen("amcl/probability", Float64, LATCHED)
    for tick in drive.ticks(2000, within_s=0.1):
        put(drive.robot, tick.map_from_robot, drive.zero_ns + tick.laser.stamp_ns)
        if drive.states and drive.states[-1].data == "localized":
            break
    assert len(beliefs) < WITHIN_STEPS
    wait_until(lambda: drive.poses)
    assert drive.error()[0] < 0.3
