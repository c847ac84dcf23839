"""From a robot's scan to AMCL's pose, over the middleware that ROS 2 has by default."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav2_msgs.msg import ParticleCloud
from std_msgs.msg import Float64, String
from vision_msgs.msg import Detection3D

from clustermcl.filter.arrays import UNKNOWN
from clustermcl.simulator.worlds.catalogue import world
from tests.integration.ros.conftest import OpenRobot, StartDrive
from tests.integration.ros.robot import LATCHED, SENSOR, WORLD
from tests.integration.waiting import wait_until


def test_a_scan_gives_amcl_pose_and_every_scan_a_transform(
    start_drive: StartDrive, open_robot: OpenRobot
) -> None:
    drive = start_drive(active=False, parameters={"coordinator.keep_pose_on_new_map": True})
    clouds = drive.robot.listen("particle_cloud", ParticleCloud, SENSOR)
    drive.robot.activate()
    drive.drive(1)
    assert not drive.poses  # no pose is given, and several places look alike
    drive.localize()
    stamps = drive.drive(30, within_s=5.0)
    assert [stamp for stamp in stamps if stamp not in drive.transforms] == []
    wait_until(lambda: clouds and drive.posed_ns in stamps)
    metres, radians = drive.error()
    assert metres < 0.15
    assert radians < 0.05
    assert drive.poses[-1].header.frame_id == clouds[-1].header.frame_id == "map"
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
    assert pose == drive.poses[-1]
    assert state.data == "localized"
    assert probability.data > 0.9
    assert len(places.results) == 1
    before = world(WORLD).map
    grown = np.pad(before.cells, ((0, 9), (0, 9)), constant_values=UNKNOWN)  # as by SLAM
    drive.robot.put_map(replace(before, cells=grown))
    drive.poses.clear()
    drive.drive_until(lambda: len(drive.poses) > 9)
    assert max(drive.error(number)[0] for number in range(9)) < 0.3
    assert drive.states[-1].data == "localized"


def test_without_a_given_pose_the_robot_is_found(start_drive: StartDrive) -> None:
    drive = start_drive()
    drive.drive_until(lambda: drive.states and drive.states[-1].data == "localized")
    stamps = drive.drive(20)
    wait_until(lambda: drive.posed_ns in stamps)
    assert drive.error()[0] < 0.2
