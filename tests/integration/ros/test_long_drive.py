"""Two hours of a robot's time, faster than it drives: all scans answered, memory constant."""

import time

import numpy as np
import psutil
import pytest

pytest.importorskip("rclpy", reason="no rclpy: see .ci/run")

from geometry_msgs.msg import PoseWithCovarianceStamped

from tests.integration.ros.conftest import OpenRobot, StartNode
from tests.integration.ros.robot import LATCHED, Drive

SCANS = 2 * 3600 * 10
WARM = 2000
GROWTH_MB = 20.0
LOST = 0.001
"""Best-effort scans that a busy machine may lose."""


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_two_hours_of_a_bag_at_speed(start_node: StartNode, open_robot: OpenRobot) -> None:
    node = start_node(parameters={"autostart_node": True})
    process = psutil.Process(node.pid)
    robot = open_robot()
    drive = Drive(robot)
    poses = robot.listen("amcl_pose", PoseWithCovarianceStamped, LATCHED)
    drive.begin()
    [stamp] = drive.drive(1)
    robot.put_initial_pose(drive.truth[stamp])
    drive.drive_until(lambda: poses)
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
    assert drive.error(poses[-1])[0] < 0.3
    assert grown_mb < GROWTH_MB
