"""Logs of Wean Hall are read as logs of CARMEN."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from benchmarks.wean import WeanRobot
from clustermcl.recordings.recording import Recording
from clustermcl.runtime.settings import BridgeSettings
from tests.unit.recordings import recording_or_skip
from tests.unit.recordings.logs import odometry_of, scans_of, seconds, words

RAMP = [round(0.01 * beam, 2) for beam in range(1, 181)]


def wean_odometry(stamp: object, pose_cm: Sequence[object] = (0, 0, 0)) -> str:
    return words("O", *pose_cm, stamp)


def wean_scan(
    stamp: object, pose_cm: Sequence[object] = (0, 0, 0), ranges: Sequence[object] = (100,) * 180
) -> str:
    x, y, heading = (float(str(value)) for value in pose_cm)
    laser = (x + 25 * math.cos(heading), y + 25 * math.sin(heading), heading)
    return words("L", *pose_cm, *laser, *ranges, stamp)


def wean_recording(folder: Path, *lines: str) -> Recording:
    (folder / "wean.log").write_text("\n".join(lines) + "\n")
    robot = WeanRobot(recording=folder / "wean.log", map=folder / "map.yaml")
    return robot.opened(BridgeSettings())


def test_wean_lines_are_centimetres(tmp_path: Path) -> None:
    recording = wean_recording(
        tmp_path,
        wean_odometry(0.5, (100, -200, 1.5)),
        wean_scan(1.25, (150, 0, math.pi / 2), range(1, 181)),
    )
    [odometry], [scan] = odometry_of(recording), scans_of(recording)
    assert (odometry.stamp_ns, odometry.odom_from_robot) == (seconds(0.5), (1.0, -2.0, 1.5))
    assert scan.odom_from_robot == pytest.approx((1.5, 0.0, math.pi / 2))
    np.testing.assert_allclose(scan.ranges.array(), RAMP, rtol=1e-6)


def test_wean_beams_run_from_the_right_to_the_left_of_a_laser_ahead(tmp_path: Path) -> None:
    [scan] = scans_of(wean_recording(tmp_path, wean_scan(1.0, (10, 20, 0.3))))
    assert scan.robot_from_laser == (0.25, 0.0, 0.0)
    assert scan.angle_min_rad == -math.pi / 2
    assert scan.angle_min_rad + 179 * scan.angle_step_rad == pytest.approx(math.radians(89))


def test_all_lines_of_the_first_recording_are_read() -> None:
    log = recording_or_skip("wean/robotdata1.log.xz")
    recording = WeanRobot(recording=log, map=log).opened(BridgeSettings())
    assert recording.skipped == ()
    assert (recording.laser_count, len(recording.readings)) == (713, 713 + 1505)
