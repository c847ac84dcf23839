import gzip
import lzma
import math
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.steps import LaserReading
from clustermcl.recordings.carmen_log import flaser_angles
from clustermcl.recordings.recording import monotonic_times, open_recording
from clustermcl.runtime.settings import BridgeSettings
from tests.unit.recordings import recording_or_skip
from tests.unit.recordings.logs import (
    flaser,
    odom,
    odometry_of,
    recording_of,
    robot_laser,
    scans_of,
    seconds,
)

RAMP = [round(0.01 * beam, 2) for beam in range(1, 181)]


# --- CARMEN -------------------------------------------------------------------------------------


def test_an_flaser_has_odometry_and_the_mount_of_the_log_or_else_of_the_settings(
    tmp_path: Path,
) -> None:
    settings = BridgeSettings(laser_x_m=0.3, laser_y_m=-0.1, laser_heading_rad=0.2)
    lines = [flaser(t, (t, 0.0, 0.1), RAMP, pose=(5.0 - t, 7.0, 1.0)) for t in (1, 2, 3)]
    parameter = "PARAM robot_frontlaser_offset 0.895 nohost 0"
    first, second, _ = scans_of(
        recording_of(tmp_path, lines[0], parameter, *lines[1:], settings=settings)
    )
    assert first.odom_from_robot == (1.0, 0.0, 0.1), "not the corrected pose"
    assert first.robot_from_laser == (0.3, -0.1, 0.2)
    assert second.robot_from_laser == (0.895, 0.0, 0.0)
    np.testing.assert_allclose(first.ranges.array(), RAMP, rtol=1e-6)


def test_a_robotlaser_line_contains_mount_angles_and_range(tmp_path: Path) -> None:
    north = (1.0, 2.0, math.pi / 2)
    line = robot_laser(3.5, [1, 2, 3, 4, 35], laser=(1.0, 2.4, math.pi / 2), robot=north)
    [scan] = scans_of(recording_of(tmp_path, line, line.replace("1000000.0 ", "")))[:1]
    assert scan.robot_from_laser == (0.4, 0.0, 0.0)
    assert scan.odom_from_robot == pytest.approx(north)
    assert (scan.angle_min_rad, scan.angle_step_rad, scan.range_max_m) == (-1.0, 0.5, 30.0)
    assert scan.stamp_ns == seconds(3.5)


def test_other_messages_of_a_log_are_skipped_silently(tmp_path: Path) -> None:
    others = ["# remark", "", "SYNC start 1 host 1", "NMEAGGA 1 2 3", "RAWLASER1 1 5 0 0 0 0 0"]
    recording = recording_of(tmp_path, *others, flaser(1, ranges=RAMP))
    assert (recording.skipped, recording.laser_count) == ((), 1)


@pytest.mark.parametrize(
    ("beams", "first_deg", "last_deg"),
    [
        (180, -90.0, 89.0),
        (181, -90.0, 90.0),
        (360, -90.0, 89.5),
        (361, -90.0, 90.0),
        (401, -50.0, 50.0),
        (541, -135.0, 135.0),
        (721, -90.0, 90.0),
        (761, -95.0, 95.0),
        (1081, -135.0, 135.0),
        (682, -90.0, 90.0 - 180.0 / 682),
        (1, -90.0, -90.0),
    ],
)
def test_the_number_of_beams_gives_their_directions(
    beams: int, first_deg: float, last_deg: float
) -> None:
    first, step = flaser_angles(beams)
    assert math.degrees(first) == pytest.approx(first_deg)
    assert math.degrees(first + step * (beams - 1)) == pytest.approx(last_deg)


# --- no return ----------------------------------------------------------------------------------


def test_a_range_that_marks_missing_returns_is_detected(tmp_path: Path) -> None:
    marked = [*RAMP[:-2], 81.91, 81.83]
    recording = recording_of(tmp_path, *(flaser(t, ranges=marked) for t in range(5)))
    limit_m = scans_of(recording)[0].range_max_m
    assert 2.0 < limit_m < 81.83


@pytest.mark.parametrize(
    "ranges",
    [
        RAMP,  # nothing stands out
        [3.0] * 180,  # a round room
        [1.0] * 170 + [4.0] * 10,  # a far wall
        [1.0 + 0.2 * beam for beam in range(180)],  # a large hall
    ],
)
def test_measured_ranges_are_kept(tmp_path: Path, ranges: list[float]) -> None:
    recording = recording_of(tmp_path, *(flaser(t, ranges=ranges) for t in range(5)))
    assert scans_of(recording)[0].range_max_m > max(ranges)


def test_a_beam_that_is_not_finite_does_not_spoil_its_scan(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, flaser(1, ranges=["nan", "inf", *RAMP[2:]]))
    [scan] = scans_of(recording)
    assert not np.isfinite(scan.ranges.array()[:2]).any()
    assert scan.range_max_m == pytest.approx(1.8 * 1.01)


# --- bad lines ----------------------------------------------------------------------------------

GOOD = [flaser(t, (t, 0, 0), RAMP) for t in (1, 2, 3)]
ROBOT = robot_laser(1, (1.0, 2.0, 3.0), (0, 0, 0), (0, 0, 0))


@pytest.mark.parametrize(
    ("bad", "problem"),
    [
        (GOOD[0][:200], "180 readings announced"),
        (GOOD[0][:-10], "words, this FLASER line needs 191"),
        ("FLASER", "without its number of readings"),
        ("FLASER 0 0 0 0 0 0 0 1 host 1", "0 readings announced"),
        (flaser(1, ranges=["x", *RAMP[1:]]), "could not convert string to float: 'x'"),
        (flaser(1, odometry=("nan", 0, 0), ranges=RAMP), "(nan 0 0) is not a pose"),
        (flaser(1, odometry=(0, 1e300, 0), ranges=RAMP), "is not a pose"),
        (flaser("soon", ranges=RAMP), "the time 'soon' is not a number"),
        (flaser("inf", ranges=RAMP), "the time 'inf' is not a time"),
        (flaser("1e30", ranges=RAMP), "is not a time in seconds"),
        ("ODOM 1 2", "3 words, this ODOM line needs 10"),
        ("PARAM robot_frontlaser_offset far nohost 0", "string to float: 'far'"),
        (ROBOT.replace(" 3.0 0 ", " 3.0 99 "), "99 readings announced"),
        (ROBOT.replace("2.0 0.5", "2.0 5.5"), "no scan"),
        (robot_laser(1, RAMP[:3], (50, 0, 0), (0, 0, 0)), "50 m from the robot"),
        ("flaser 180 1 2 3", "unknown kind of line 'flaser'"),
        ("\x00\xff\x00", "unknown kind of line"),
    ],
)
def test_a_malformed_line_is_listed_and_the_rest_is_read(
    tmp_path: Path, bad: str, problem: str
) -> None:
    recording = recording_of(tmp_path, GOOD[0], bad, *GOOD[1:])
    assert recording.laser_count == 3
    [skipped] = recording.skipped
    assert skipped.line_number == 2
    assert problem in skipped.problem


@pytest.mark.parametrize("pack", [gzip.compress, lzma.compress])
def test_a_packed_recording_is_read_up_to_its_end(
    tmp_path: Path, pack: Callable[[bytes], bytes]
) -> None:
    random = np.random.default_rng(1)
    lines = [flaser(t, ranges=random.uniform(1, 5, 180).round(2).tolist()) for t in range(200)]
    path, packed = tmp_path / "log", pack("\n".join(lines).encode())
    path.write_bytes(packed)
    assert open_recording(path, BridgeSettings()).laser_count == 200
    path.write_bytes(packed[: len(packed) // 2])
    recording = open_recording(path, BridgeSettings())
    assert 50 < recording.laser_count < 200
    assert "cut off" in recording.skipped[-1].problem


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"", "empty"),
        (b"\n\n# nothing\n", "empty"),
        (b"image: map.pgm\nresolution: 0.05\n", "not a recording"),
        (b"#ROSBAG V2.0\n\x00\x01\n", "cannot be read as a ROS bag"),
        (bytes(range(256)) * 400, "not a recording"),
        (
            odom(1).encode() + b"\nFLASER 1 2\n",
            "no scan in it: 1 readings of odometry, 1 bad lines",
        ),
    ],
)
def test_a_file_that_is_not_a_recording_is_refused(
    tmp_path: Path, content: bytes, problem: str
) -> None:
    path = tmp_path / "log"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=problem) as caught:
        open_recording(path, BridgeSettings())
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_pipes_and_impossible_names_are_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "log")
    for name, problem in (("log", "is a pipe"), ("x" * 300, "cannot be read: File name too long")):
        with pytest.raises(RecordingError, match=problem):
            open_recording(tmp_path / name, BridgeSettings())


# --- time ---------------------------------------------------------------------------------------


def test_odometry_and_scans_are_merged_by_time(tmp_path: Path) -> None:
    lines = [flaser(2, ranges=RAMP), flaser(4, ranges=RAMP), odom(1), odom(3), odom(5)]
    recording = recording_of(tmp_path, *lines)
    assert [reading.stamp_ns for reading in recording.readings] == [
        seconds(t) for t in (1, 2, 3, 4, 5)
    ]
    assert recording.readings[-1].stamp_ns - recording.readings[0].stamp_ns == 4 * 10**9


def test_a_sensor_keeps_its_order_where_stamps_step_back(tmp_path: Path) -> None:
    stamps = [1.0, 2.9, 2.2, 2.4, 3.0]
    lines = [odom(t, (x, 0, 0)) for x, t in enumerate(stamps)]
    recording = recording_of(tmp_path, *lines, flaser(4.0, ranges=RAMP), flaser(3.5, ranges=RAMP))
    odometry = odometry_of(recording)
    assert [reading.odom_from_robot[0] for reading in odometry] == [0, 1, 2, 3, 4]
    mended = [reading.stamp_ns for reading in odometry]
    assert mended == sorted(mended)
    assert max(abs(np.array(mended) - [seconds(t) for t in stamps])) < 0.5e9
    # A reference knows a scan by the stamp in the file.
    assert [scan.stamp_ns for scan in scans_of(recording)] == [seconds(4.0), seconds(3.5)]


STAMPS = st.lists(st.integers(-(10**18), 10**18), max_size=30)


@given(STAMPS)
def test_corrected_times_never_decrease_and_are_near_the_stamps(stamps: list[int]) -> None:
    times = np.array(stamps, np.int64)
    corrected = monotonic_times(times)
    assert np.all(np.diff(corrected) >= 0)
    largest_step_back = (np.maximum.accumulate(times) - times).max(initial=0)
    assert np.abs(corrected - times).max(initial=0) <= largest_step_back


def test_a_line_with_an_impossible_stamp_is_skipped(tmp_path: Path) -> None:
    lines = [odom(t) for t in (1000, 1001, 0, 1002, 1003, 99999, 1004, 1005)]
    recording = recording_of(tmp_path, *lines, flaser(1006, ranges=RAMP))
    assert [line.line_number for line in recording.skipped] == [3, 6]
    assert "far from that of its neighbours" in recording.skipped[0].problem
    assert recording.readings[-1].stamp_ns - recording.readings[0].stamp_ns == 6 * 10**9


def test_a_clock_that_restarts_ends_the_recording(tmp_path: Path) -> None:
    once = [flaser(t, ranges=RAMP) for t in (-5000, 0, *range(102, 110))]  # gaps are accepted
    again = [flaser(t, ranges=RAMP) for t in range(5)]
    recording = recording_of(tmp_path, *once, *again)
    assert recording.laser_count == 10
    assert recording.skipped[-1].line_number == 11
    assert "time steps back by 109 s" in recording.skipped[-1].problem


def test_stamps_are_exact_to_the_nanosecond(tmp_path: Path) -> None:
    [scan] = scans_of(recording_of(tmp_path, flaser("1411657682.066704001", ranges=RAMP)))
    assert scan.stamp_ns == 1411657682066704001


# --- recordings of real robots ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "scans", "odometry", "marker_m"),
    [
        ("aces/log.clf.gz", 264, 4160, 50.0),
        ("belgioioso/log.clf.gz", 395, 4085, 81.91),
        ("crob-jarvis/log.clf.gz", 212, 638, None),
        ("edmonton/log.clf.gz", 340, 6011, 51.1),
        ("fr101/log.clf.gz", 292, 4277, 81.83),
    ],
)
def test_all_lines_of_real_recordings_are_read(
    name: str, scans: int, odometry: int, marker_m: float | None
) -> None:
    recording = open_recording(recording_or_skip(name), BridgeSettings())
    assert recording.skipped == ()
    assert recording.laser_count == scans
    assert len(recording.readings) == scans + odometry
    first = scans_of(recording)[0]
    longest = max(float(scan.ranges.array().max()) for scan in scans_of(recording))
    if marker_m is None:
        assert first.range_max_m > longest
    else:
        assert 0.95 * marker_m < first.range_max_m < marker_m


def test_the_length_of_the_intel_path_is_kept_despite_wrong_stamps() -> None:
    recording = open_recording(recording_or_skip("intel/log.clf.gz"), BridgeSettings())
    places = np.array([reading.odom_from_robot[:2] for reading in odometry_of(recording)])
    path_m = np.hypot(*np.diff(places, axis=0).T).sum()
    assert path_m == pytest.approx(508.4, abs=0.1)  # sorted by stamp it would be 660 m
    assert all(isinstance(scan, LaserReading) for scan in scans_of(recording))
