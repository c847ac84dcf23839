"""From a robot's scan to AMCL's pose, over the middleware that ROS 2 has by default."""

import time

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav2_msgs.msg import ParticleCloud
from std_msgs.msg import Float64, String
from vision_msgs.msg import Detection3D

from tests.integration.ros.conftest import OpenRobot, StartDrive
from tests.integration.ros.robot import LATCHED, SENSOR
from tests.integration.waiting import wait_until

SCANS = 2 * 3600 * 10
WARM = 2000
GROWTH_MB = 20.0
LOST = 0.001
"""Best-effort scans that a busy machine may lose."""


def test_a_scan_gives_amcl_pose_and_every_scan_a_transform(
    start_drive: StartDrive, open_robot: OpenRobot
) -> None:
    drive = start_drive(active=False)
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


def test_without_a_given_pose_the_robot_is_found(start_drive: StartDrive) -> None:
    drive = start_drive()
    drive.drive_until(lambda: drive.states and drive.states[-1].data == "localized")
    stamps = drive.drive(20)
    wait_until(lambda: drive.posed_ns in stamps)
    assert drive.error()[0] < 0.2


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_two_hours_of_a_bag_at_speed(start_drive: StartDrive) -> None:
    drive = start_drive()
    process = psutil.Process(drive.node.pid)
    drive.localize()
    drive.drive(WARM)
    warm_mb, begin_s = process.memory_info().rss / 1e6, time.monotonic()
    stamps = drive.drive(SCANS, within_s=2.0)
    took_s = time.monotonic() - begin_s
    answered = [one for one in stamps if one in drive.transforms]
    delays_ms = [1e3 * (drive.transforms[one][0] - drive.sent_s[one]) for one in answered]
    grown_mb = process.memory_info().rss / 1e6 - warm_mb
    print(  # noqa: T201 - the figures that docs/ros2.md has
        f"{len(answered)} of {SCANS} scans in {took_s:.0f} s, p50, p95, p99"
        f" {np.percentile(delays_ms, (50, 95, 99))} ms; {warm_mb:.0f} MB, then {grown_mb:+.1f}"
    )
    assert len(answered) > (1.0 - LOST) * SCANS
    assert drive.error()[0] < 0.3
    assert grown_mb < GROWTH_MB
