"""Several robots, domains, lasers, clocks, and sensors that name the place."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from apriltag_msgs.msg import AprilTagDetection, AprilTagDetectionArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Float64, String
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

from clustermcl.filter.poses import between
from clustermcl.protocol.message import PoseTuple
from tests.integration.ros.conftest import OpenRobot, StartNode
from tests.integration.ros.robot import LATCHED, Drive, Robot, link, ns_of, pose_message, time_of
from tests.integration.waiting import wait_until

ACTIVE = {"autostart_node": True}
TF_IN_NAMESPACE = ("-r", "/tf:=tf", "-r", "/tf_static:=tf_static")
STARTS = ((5.0, 0.0, 0.0), (-5.0, 0.0, 0.0))
LANDMARK = (4.0, 1.0)
DATUM = (52.0, 4.0)
EQUATOR_M, SQUARED_ECCENTRICITY = 6378137.0, 6.69437999014e-3
WITHIN_STEPS = 30
"""Without other sensors, the robot needs more to find its corridor."""


def localized(robot: Robot, drive: Drive) -> list[Any]:
    """Give the robot its pose; return the growing list of poses."""
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    drive.begin()
    [stamp] = drive.drive(1)
    robot.put_initial_pose(drive.truth[stamp])
    drive.drive_until(lambda: poses)
    drive.drive(5)
    return poses


def test_two_robots_in_one_domain_do_not_disturb_each_other(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    names = ("robot1", "robot2")
    for name in names:
        start_node("-r", f"__ns:=/{name}", *TF_IN_NAMESPACE, parameters=ACTIVE)
    robots = [open_robot(f"/{name}") for name in names]
    drives = [Drive(robot, start=start) for robot, start in zip(robots, STARTS, strict=True)]
    poses = [localized(*both) for both in zip(robots, drives, strict=True)]
    for drive in drives * 2:
        drive.drive(5)
    assert math.dist(*(d.truth[max(d.truth)][:2] for d in drives)) > 1.0
    for drive, received in zip(drives, poses, strict=True):
        assert {ns_of(one.header.stamp) for one in received} <= drive.truth.keys()
        assert drive.error(received[-1])[0] < 0.3
    assert not robots[0].node.count_publishers("/tf")


def test_a_node_in_domain_7_is_heard_there_alone(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    start_node(parameters=ACTIVE, in_domain=7)
    robot, elsewhere = open_robot(in_domain=7), open_robot()
    drive = Drive(robot)
    assert drive.error(localized(robot, drive)[-1])[0] < 0.3
    assert ("amcl", "/") not in elsewhere.node.get_node_names_and_namespaces()


def test_two_lasers_on_two_topics_localize_one_robot(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    start_node(parameters={**ACTIVE, "scan_topic": ["front/scan", "rear/scan"]})
    robot = open_robot()
    drive = Drive(robot, lasers=(("front", "front/scan"), ("rear", "rear/scan")))
    poses = localized(robot, drive)
    stamps = drive.drive(20)
    assert [stamp for stamp in stamps if stamp not in drive.transforms] == []
    assert drive.error(poses[-1])[0] < 0.3


def test_the_pose_follows_after_simulated_time_is_set_back(
    start_node: StartNode, open_robot: OpenRobot
) -> None:
    node = start_node(parameters={**ACTIVE, "use_sim_time": True})
    robot = open_robot()
    begin_ns = 1000 * 10**9

    def once() -> tuple[Drive, list[Any]]:
        drive = Drive(robot, zero_ns=begin_ns)
        step = drive.step

        def with_clock(tick: Any, within_s: float) -> None:
            robot.put_clock(begin_ns + tick.laser.stamp_ns)
            step(tick, within_s)

        drive.step = with_clock  # type: ignore[method-assign]
        poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
        drive.begin()
        return drive, poses

    def follow(drive: Drive, poses: list[Any]) -> int:
        [stamp] = drive.drive(1)
        robot.put_initial_pose(drive.truth[stamp])
        drive.drive_until(lambda: poses and drive.error(poses[-1])[0] < 0.3)
        drive.drive(60)
        wait_until(lambda: ns_of(poses[-1].header.stamp) in list(drive.truth)[-60:])
        assert drive.error(poses[-1])[0] < 0.3
        return ns_of(poses[-1].header.stamp)

    last = follow(*once())
    drive, poses = once()
    drive.drive_until(lambda: "set back" in node.err)  # the bag begins again
    poses.clear()
    assert follow(drive, poses) < last + 10 * 10**9
    assert node.is_running()


def fix_of(pose: PoseTuple, stamp_ns: int) -> Any:
    """A satellite fix in a map whose x axis points east at `DATUM`."""
    latitude = math.radians(DATUM[0])
    bend = 1.0 - SQUARED_ECCENTRICITY * math.sin(latitude) ** 2
    north_m = EQUATOR_M * (1.0 - SQUARED_ECCENTRICITY) / bend**1.5
    east_m = EQUATOR_M / math.sqrt(bend) * math.cos(latitude)
    message = NavSatFix(
        latitude=DATUM[0] + math.degrees(pose[1] / north_m),
        longitude=DATUM[1] + math.degrees(pose[0] / east_m),
        position_covariance=[0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01],
        position_covariance_type=2,
    )
    message.status.status = 2
    message.header.frame_id, message.header.stamp = "base_footprint", time_of(stamp_ns)
    return message


def put_fix(robot: Robot, pose: PoseTuple, stamp_ns: int) -> None:
    robot.publisher("gnss/fix", NavSatFix).publish(fix_of(pose, stamp_ns))


def put_pose(robot: Robot, pose: PoseTuple, stamp_ns: int) -> None:
    message = pose_message(pose, stamp_ns=stamp_ns, sigma=0.1)
    robot.publisher("uwb/pose", PoseWithCovarianceStamped).publish(message)


def landmark_from(pose: PoseTuple) -> PoseTuple:
    x, y, _ = between(pose, (*LANDMARK, 0.0))
    return float(x), float(y), 0.0


def put_tag(robot: Robot, pose: PoseTuple, stamp_ns: int) -> None:
    seen = link("base_footprint", "tag36h11:7", landmark_from(pose), stamp_ns)
    robot.publisher("tf", TFMessage, 100).publish(TFMessage(transforms=[seen]))
    message = AprilTagDetectionArray(detections=[AprilTagDetection(family="tag36h11", id=7)])
    message.header.frame_id, message.header.stamp = "base_footprint", time_of(stamp_ns)
    robot.publisher("tags", AprilTagDetectionArray).publish(message)


def put_detection(robot: Robot, pose: PoseTuple, stamp_ns: int) -> None:
    result = ObjectHypothesisWithPose()
    result.hypothesis.class_id, result.hypothesis.score = "tag36h11:7", 0.9
    at = landmark_from(pose)
    result.pose.pose.position.x, result.pose.pose.position.y = at[:2]
    message = Detection3DArray(detections=[Detection3D(results=[result])])
    message.header.frame_id, message.header.stamp = "base_footprint", time_of(stamp_ns)
    message.detections[0].header = message.header
    robot.publisher("objects", Detection3DArray).publish(message)


@pytest.mark.parametrize(
    ("put", "parameters"),
    [
        (put_fix, {"ros2.gnss_topics": "gnss/fix", "ros2.datum": "52.0, 4.0, 0"}),
        (put_pose, {"ros2.pose_topics": "uwb/pose"}),
        (put_tag, {"ros2.tag_topics": "tags"}),
        (put_detection, {"ros2.detection_topics": "objects"}),
    ],
)
def test_a_sensor_that_names_the_place_localizes_the_robot_at_once(
    start_node: StartNode,
    open_robot: OpenRobot,
    tmp_path: Path,
    put: Callable[[Robot, PoseTuple, int], None],
    parameters: dict[str, str],
) -> None:
    x, y = LANDMARK
    landmarks = tmp_path / "landmarks.yaml"
    landmarks.write_text(f'landmarks:\n  - {{id: "tag36h11:7", x: {x}, y: {y}}}\n')
    start_node(parameters={**ACTIVE, "bridge.landmarks": str(landmarks), **parameters})
    robot = open_robot()
    drive = Drive(robot)
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    states = robot.listen("amcl/state", String, LATCHED)
    beliefs = robot.listen("amcl/probability", Float64, LATCHED)
    drive.begin()
    for tick in drive.ticks(2000, within_s=0.1):
        put(robot, tick.map_from_robot, drive.zero_ns + tick.laser.stamp_ns)
        if states and states[-1].data == "localized":
            break
    assert len(beliefs) < WITHIN_STEPS
    wait_until(lambda: poses)
    assert drive.error(poses[-1])[0] < 0.3
