import math
import shutil
import sqlite3
import struct
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import reader as library
from scipy.spatial.transform import Rotation

from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.steps import LaserReading
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import beams_of
from tests.unit.recordings.bags import (
    FORMS,
    LEVEL,
    ROLLED_OVER,
    Sent,
    about_z,
    fixed_tf,
    odometry,
    scan,
    tf,
    written,
)
from tests.unit.recordings.logs import beam_ends, odometry_of, scans_of

MOUNT = fixed_tf("base_link", "laser", (0.3, 0.1, 0.2), about_z(0.25))
S = 1_000_000_000


def drive(steps: int = 10, *, beams: int = 3) -> list[Sent]:
    """A robot that drives along x at 1 m/s and turns by 0.1 rad/s, scans between odometry."""
    sent: list[Sent] = []
    for second in range(1, steps + 1):
        place, turn = (float(second), 0.0, 0.0), about_z(0.1 * second)
        sent.append(tf(second * S, "odom", "base_link", place, turn))
        ranges = np.random.default_rng(second).uniform(1, 5, beams).tolist()
        sent.append(scan(second * S + S // 2, ranges, step=0.5 if beams < 10 else 0.001))
    return sent


def opened(folder: Path, sent: Sequence[Sent], form: str = "mcap", **settings: Any) -> Recording:
    path = written(folder, form, sent)
    return open_recording(path, BridgeSettings(**settings))


def only_scan(folder: Path, *sent: Sent, **settings: Any) -> LaserReading:
    moves = [tf(t * S, "odom", "base_link", (float(t), 0, 0)) for t in range(3)]
    return scans_of(opened(folder, [*moves, *sent], **settings))[0]


def refusal(folder: Path, sent: Sequence[Sent], **settings: str) -> str:
    with pytest.raises(RecordingError) as caught:
        opened(folder, sent, **settings)
    assert "\n" not in str(caught.value)
    return caught.value.problem


# --- forms --------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", FORMS)
def test_every_bag_format_gives_the_same_readings(tmp_path: Path, form: str) -> None:
    sent = [MOUNT, *drive()]
    recording = opened(tmp_path, sent, form)
    assert recording.readings == opened(tmp_path / "plain", sent, "mcap bare").readings
    assert [reading.stamp_ns for reading in scans_of(recording)] == [
        second * S + S // 2 for second in range(1, 11)
    ]
    assert recording.skipped == ()
    poses = [reading.odom_from_robot for reading in odometry_of(recording)]
    expected = [(t, 0.0, 0.1 * t) for t in range(1, 11)]
    np.testing.assert_allclose(poses, expected, atol=1e-12)  # rounding of quaternions
    np.testing.assert_allclose(scans_of(recording)[0].robot_from_laser, (0.3, 0.1, 0.25))


def test_a_bag_of_ros_1_may_have_any_name_and_one_of_ros_2_needs_its_suffix(tmp_path: Path) -> None:
    path = written(tmp_path, "ros1", [MOUNT, *drive()])
    recording = open_recording(path.rename(tmp_path / "recording"), BridgeSettings())
    assert recording.laser_count == 10
    path = written(tmp_path, "mcap bare", [MOUNT, *drive()])
    with pytest.raises(RecordingError, match=r"give its name the suffix \.mcap"):
        open_recording(path.rename(tmp_path / "bag"), BridgeSettings())


def test_several_bags_in_a_folder_need_metadata(tmp_path: Path) -> None:
    folder = written(tmp_path, "mcap without metadata", [MOUNT, *drive()])
    file = next(folder.iterdir())
    shutil.copyfile(file, folder / "second.mcap")
    with pytest.raises(RecordingError, match=r"2 bag files without metadata\.yaml; name one"):
        open_recording(folder, BridgeSettings())


def test_without_rosbags_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, "mcap", drive())
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(RecordingError, match=r"pip install 'clustermcl\[ros2\]'"):
        open_recording(path, BridgeSettings())


def test_an_unknown_encoding_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, "mcap bare", drive(), encoding="flatbuffer")
    with pytest.raises(RecordingError, match="is encoded as 'flatbuffer', not as ROS's CDR"):
        open_recording(path, BridgeSettings())


# --- what is chosen -----------------------------------------------------------------------------


def test_two_scan_topics_need_a_name(tmp_path: Path) -> None:
    sent = [MOUNT, *drive(), scan(S, (4.0,), topic="/rear/scan")]
    problem = refusal(tmp_path, sent)
    assert "/rear/scan, /scan" in problem
    assert "--scan-topic" in problem
    named = opened(tmp_path / "named", sent, scan_topic="/rear/scan")
    assert named.laser_count == 1


def test_lasers_keep_their_own_mounts_and_scans_without_one_are_listed(tmp_path: Path) -> None:
    rear = fixed_tf("base_link", "rear", (-0.4, 0.0, 0.2), about_z(math.pi / 2))
    others = [scan(2 * S, frame="rear"), scan(2 * S, frame="lost")]
    recording = opened(tmp_path, [MOUNT, rear, *drive(), *others])
    mounts = sorted({reading.robot_from_laser for reading in scans_of(recording)})
    np.testing.assert_allclose(mounts, [(-0.4, 0.0, math.pi / 2), (0.3, 0.1, 0.25)], atol=1e-12)
    assert "no transform from 'base_link' to the laser's frame 'lost'" in (
        recording.skipped[0].problem
    )


@pytest.mark.parametrize(("sent", "settings", "words"), [
    ([MOUNT, *drive()], {"scan_topic": "/front"},
     ["no sensor_msgs/LaserScan on /front; the bag has /scan"]),
    ([MOUNT], {}, ["0 topics of sensor_msgs/LaserScan; the bag has /tf_static"]),
    (drive(), {},
     ["no transform of the laser's frame 'laser'", "tf has odom -> base_link", "/tf_static"]),
    ([MOUNT, scan(S)], {}, ["no odometry"]),
    ([*drive(), odometry(S, (0, 0, 0))], {},
     ["no transform from 'base_link' to the laser's frame 'laser'", "tf has odom -> base_link"]),
    ([MOUNT, scan(S), odometry(S, (0, 0, 0)), odometry(S, (0, 0, 0), topic="/visual")], {},
     ["/odom, /visual", "--odom-topic"]),
    ([tf(S, "base_link", "laser"), tf(S, "camera", "laser"), *drive()], {},
     ["tf gives the frame 'laser' 2 parents: base_link and camera"]),
], ids=[
    "an unknown topic", "no scans", "no laser in tf", "no odometry", "no mount",
    "two odometry topics",
    "a frame with two parents",
])  # fmt: skip
def test_a_bag_that_cannot_be_used_is_refused_with_what_it_has(
    tmp_path: Path, sent: list[Sent], settings: dict[str, str], words: list[str]
) -> None:
    problem = refusal(tmp_path, sent, **settings)
    assert all(word in problem for word in words)


def test_the_settings_give_the_mount_of_a_laser_that_tf_lacks(tmp_path: Path) -> None:
    sent = [odometry(t * S, (t, 0, 0), 0.1 * t) for t in range(5)] + [scan(2 * S)]
    recording = opened(tmp_path, sent, laser_x_m=0.2)
    assert scans_of(recording)[0].robot_from_laser == (0.2, 0.0, 0.0)
    poses = [reading.odom_from_robot for reading in odometry_of(recording)]
    np.testing.assert_allclose(poses, [(t, 0.0, 0.1 * t) for t in range(5)], atol=1e-12)


def test_tf_is_preferred_to_an_unnamed_odometry_topic(tmp_path: Path) -> None:
    sent = [MOUNT, *drive(), odometry(3 * S, (99, 0, 0)), odometry(4 * S, (98, 0, 0))]
    places = [reading.odom_from_robot[0] for reading in odometry_of(opened(tmp_path, sent))]
    assert places == list(range(1, 11))
    named = opened(tmp_path / "named", sent, odom_topic="/odom")
    assert [reading.odom_from_robot[0] for reading in odometry_of(named)] == [99, 98]


def test_an_odometry_frame_of_another_name_must_be_named(tmp_path: Path) -> None:
    moves = [tf(t * S, "r1/odom", "r1/base", (t, 0, 0)) for t in range(4)]
    sent = [*moves, fixed_tf("r1/base", "laser", (0.1, 0, 0)), scan(S)]
    problem = refusal(tmp_path, sent)
    assert "r1/odom <- r1/base <- laser" in problem
    assert "--odom-frame" in problem
    named = opened(tmp_path / "named", sent, odom_frame="r1/odom")
    assert scans_of(named)[0].robot_from_laser == (0.1, 0.0, 0.0)


def test_the_tf_of_another_robot_is_not_used(tmp_path: Path) -> None:
    other = [tf(t * S, "odom", "base_link", (-t, 0, 0), topic="/r2/tf") for t in range(4)]
    own = [tf(t * S, "odom", "base_link", (t, 0, 0), topic="/r1/tf") for t in range(4)]
    mount = tf(0, "base_link", "laser", (0.1, 0, 0), topic="/r1/tf")
    sent = [mount, *other, *own, scan(S, topic="/r1/front/scan")]
    places = [reading.odom_from_robot[0] for reading in odometry_of(opened(tmp_path, sent))]
    assert places == [0, 1, 2, 3]
    stray = [mount, *other, *own, scan(S, topic="/scan")]
    assert "several robots' tf" in refusal(tmp_path / "stray", stray)


# --- frames -------------------------------------------------------------------------------------


def test_a_named_base_frame_applies_to_odometry_and_mount(tmp_path: Path) -> None:
    axle = fixed_tf("base_link", "axle", (-1.0, 0.0, 0.0))
    recording = opened(tmp_path, [MOUNT, axle, *drive()], base_frame="axle")
    np.testing.assert_allclose(scans_of(recording)[0].robot_from_laser, (1.3, 0.1, 0.25))
    first = odometry_of(recording)[0].odom_from_robot
    np.testing.assert_allclose(first, (1 - math.cos(0.1), -math.sin(0.1), 0.1))


@pytest.mark.parametrize("turn", [LEVEL, ROLLED_OVER, (0.0, 1.0, 0.0, 0.0), about_z(2.0)])
def test_beam_end_points_agree_with_tf_also_for_a_laser_upside_down(
    tmp_path: Path, turn: tuple[float, float, float, float]
) -> None:
    mount = fixed_tf("base_link", "laser", (0.3, 0.1, 0.2), turn)
    reading = only_scan(tmp_path, mount, scan(S, (1.0, 2.0, 4.0)))
    angles = -0.25 + 0.5 * np.arange(3)
    seen = np.array([1.0, 2.0, 4.0])[:, None] * np.column_stack(
        [np.cos(angles), np.sin(angles), np.zeros(3)]
    )
    ends = Rotation.from_quat(turn).apply(seen) + np.array([0.3, 0.1, 0.2])
    beams = beams_of(reading)
    assert beams.angle_step_rad > 0.0
    expected = ends[:, :2] if beams.ranges == reading.ranges else ends[::-1, :2]
    np.testing.assert_allclose(beam_ends(beams), expected, atol=1e-5)


def test_a_laser_on_a_chain_of_frames_is_placed_at_the_scan_s_time(tmp_path: Path) -> None:
    mast = fixed_tf("base_link", "mast", (0.5, 0.0, 1.0), about_z(math.pi / 2))
    turret = [tf(t * S, "mast", "turret", (0, 0, 0), about_z(0.2 * t)) for t in range(3)]
    laser = fixed_tf("turret", "laser", (0.1, 0.0, 0.0))
    reading = only_scan(tmp_path, mast, *turret, laser, scan(S + S // 2))
    heading = math.pi / 2 + 0.3
    expected = (0.5 + 0.1 * math.cos(heading), 0.1 * math.sin(heading), heading)
    np.testing.assert_allclose(reading.robot_from_laser, expected)


def test_a_moving_mount_is_not_guessed_long_after_its_last_transform(tmp_path: Path) -> None:
    turret = [tf(t * S, "base_link", "laser", (0, 0, 0), about_z(0.2 * t)) for t in range(3)]
    moves = [tf(t * S, "odom", "base_link", (t, 0, 0)) for t in range(9)]
    recording = opened(tmp_path, [*moves, *turret, scan(S), scan(8 * S)])
    assert recording.laser_count == 1
    ended = "tf from 'base_link' to 'laser' ends 6.000 s before that time"
    assert recording.skipped[0].problem == ended


def test_a_tilted_laser_is_refused_and_a_little_tilt_is_not(tmp_path: Path) -> None:
    def pitched(degrees: float) -> Sent:
        x, y, z, w = Rotation.from_euler("y", degrees, degrees=True).as_quat().tolist()
        return fixed_tf("base_link", "laser", (0.0, 0.0, 0.2), (x, y, z, w))

    problem = refusal(tmp_path, [pitched(20), *drive()])
    assert problem == "the laser 'laser' is tilted by 20 degrees"
    assert only_scan(tmp_path / "little", pitched(3), scan(S)).robot_from_laser[2] == 0.0
    far = fixed_tf("base_link", "laser", (0.0, 11.0, 0.0))
    assert refusal(tmp_path / "far", [far, *drive()]) == "the laser 'laser' is 11 m away"


NOWHERE = (math.nan, 0.0, 0.0)


@pytest.mark.parametrize(
    ("place", "turn"),
    [((0, 0, 0), (0.0,) * 4), ((0, 0, 0), (math.nan, 0.0, 0.0, 1.0)), (NOWHERE, LEVEL)],
)
def test_an_invalid_transform_is_skipped_and_listed(
    tmp_path: Path, place: Sequence[float], turn: Sequence[float]
) -> None:
    recording = opened(tmp_path, [MOUNT, tf(S, "odom", "base_link", place, turn), *drive()])
    assert len(odometry_of(recording)) == 10
    assert "from 'odom' to 'base_link' tf has" in recording.skipped[0].problem


# --- ranges -------------------------------------------------------------------------------------


def test_ranges_outside_the_limits_of_the_scan_are_no_returns(tmp_path: Path) -> None:
    ranges = (0.05, 0.5, math.inf, math.nan, -math.inf, 9.0, 11.0, 0.1)
    mount = fixed_tf("base_link", "laser", (0.0, 0.0, 0.0))
    reading = only_scan(tmp_path, mount, scan(S, ranges, step=0.1))
    assert only_scan(tmp_path / "0", mount, scan(S, (24.0,), range_max=0.0)).range_max_m > 24.0
    values = reading.ranges.array()
    used = np.isfinite(values) & (values > 0.0) & (values < reading.range_max_m)
    assert values[used].tolist() == np.array([0.5, 9.0, 0.1], np.float32).tolist()


# --- damage -------------------------------------------------------------------------------------


def read_or_refused(path: Path) -> Recording | str:
    try:
        return open_recording(path, BridgeSettings())
    except RecordingError as refused:
        return str(refused)


@pytest.mark.parametrize(("form", "tool"), [
    ("ros1", "rosbag reindex"), ("sqlite3 bare", "sqlite3 FILE .recover"),
    ("mcap bare", "mcap recover"),
])  # fmt: skip
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_truncated_bags_are_refused_with_a_repair_tool(
    tmp_path: Path, form: str, tool: str, share: float
) -> None:
    path = written(tmp_path, form, [MOUNT, *drive(60, beams=2000)])
    with path.open("r+b") as file:
        file.truncate(int(path.stat().st_size * share))
    refused = read_or_refused(path)
    assert isinstance(refused, str)
    assert tool in refused
    assert "\n" not in refused


@pytest.mark.parametrize("form", ["ros1", "sqlite3 bare", "mcap bare"])
def test_a_damaged_bag_is_read_or_refused_in_one_line(tmp_path: Path, form: str) -> None:
    path = written(tmp_path, form, [MOUNT, *drive()])
    whole, random = np.frombuffer(path.read_bytes(), np.uint8), np.random.default_rng(1)
    for _ in range(20):
        content = whole.copy()
        content[random.integers(0, len(content), 40)] = random.integers(0, 256, 40)
        path.write_bytes(content.tobytes())
        outcome = read_or_refused(path)
        assert isinstance(outcome, Recording) or "\n" not in outcome


def _length(content: bytes, at: int, form: str) -> int:
    return int(struct.unpack_from(form, content, at)[0]) + struct.calcsize(form)


def with_repeated_index(content: bytes, times: int) -> bytes:
    """A bag whose index names each of its chunks several times."""
    if content.startswith(b"#ROSBAG"):
        at = content.index(b"index_pos=") + 10
        at, count_at = _length(content, at, "<Q") - 8, content.index(b"chunk_count=") + 12
        for _ in range(2):  # the connection's record
            at += _length(content, at, "<I")
        head = content[:count_at] + struct.pack("<I", times) + content[count_at + 4 : at]
        return head + content[at:] * times
    at = _length(content, len(content) - 28, "<Q") - 8
    parts = [content[:at]]
    while content[at] != 2:  # the footer
        end = at + 1 + _length(content, at + 1, "<Q")
        parts.append(content[at:end] * (times if content[at] == 8 else 1))
        at = end
    return b"".join(parts) + content[at:]


@pytest.mark.parametrize("form", ["ros1", "mcap bare"])
def test_chunks_that_lie_one_over_the_other_are_refused(tmp_path: Path, form: str) -> None:
    path = written(tmp_path, form, [scan(second) for second in range(1, 301)])
    path.write_bytes(with_repeated_index(path.read_bytes(), 300))
    assert "parts of it lie one over the other" in str(read_or_refused(path))


@pytest.mark.parametrize(
    "part", ["COLUMN x AS (zeroblob(9))", f"COLUMN x DEFAULT '{100 * '.'}'", "VIEW x AS SELECT 1"]
)
def test_a_database_that_computes_its_rows_is_refused(tmp_path: Path, part: str) -> None:
    path = written(tmp_path, "sqlite3 bare", drive())
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"{'CREATE' if part[0] == 'V' else 'ALTER TABLE messages ADD'} {part}")
    assert "it has views, or columns that are computed" in str(read_or_refused(path))


def test_a_database_of_a_killed_recorder_is_refused_without_its_last_rows(tmp_path: Path) -> None:
    path = written(tmp_path, "sqlite3 bare", drive())
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 1, '')")
        database.commit()
        assert "its end is in" in str(read_or_refused(path))


@pytest.mark.parametrize("more", ["x: &a [*a]", "x: " + 2**19 * "."])
def test_metadata_are_read_within_limits(tmp_path: Path, more: str) -> None:
    path = written(tmp_path, "mcap", drive())
    with (path / "metadata.yaml").open("a") as metadata:
        metadata.write(more)
    assert "YAML" in str(read_or_refused(path))
    assert vars(library)["YAML"].__module__.startswith("ruamel"), "other programs read as before"
