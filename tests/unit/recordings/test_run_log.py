import base64
import json
import random
import resource
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from clustermcl.filter.poses import compose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.job_events import JobEvents
from clustermcl.protocol.steps import Landmark, LaserBeams, LaserReading, Scan
from clustermcl.recordings import run_log
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import open_recording
from clustermcl.recordings.run_log import (
    BELIEF,
    JOB_EVENTS,
    RunLog,
    RunLogReader,
    is_run_log,
    last_map,
)
from clustermcl.runtime.output_files import OutputError
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.recorded import steps_of
from clustermcl.simulator.worlds.catalogue import world
from tests.unit.recordings.bombs import bomb
from tests.unit.recordings.logs import odometry_of
from tests.unit.view.messages import belief, scan

ROOT = Path(__file__).parents[3]
STEPS = 12
EVENTS = JobEvents(sender="c", events=(), term=1)


def step_scan(step: int) -> Scan:
    beams = LaserBeams(
        robot_from_laser=(-0.4, 0.0, np.pi), angle_min_rad=0.0, angle_step_rad=0.5,
        range_max_m=10.0, ranges=ArrayBlob.of(np.array([1.0, 1.0 / 3.0]), "float32"),
    )  # fmt: skip
    made = scan(step, [2.0, 11.0, np.nan, 3.1])
    return msgspec.structs.replace(
        made, stamp_ns=step * 10**8, others=(beams,), odom_from_robot=(0.3 * step, -0.1, 0.02)
    )


def write_run(path: Path) -> None:
    """Two lasers; each step is a chunk."""
    with RunLog(path) as log:
        log.on_map(world("cross").map, 0)
        for step in range(STEPS):
            seen = step_scan(step)
            log.on_scan(seen, seen.stamp_ns)
            reported = msgspec.structs.replace(
                belief(step, 4, 7) if step else belief(step),
                stamp_ns=seen.stamp_ns, odom_from_robot=seen.odom_from_robot,
            )  # fmt: skip
            log.on_belief(reported, seen.stamp_ns)
            log.write(JOB_EVENTS, EVENTS, seen.stamp_ns)
            log.flush()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    write_run(path)
    return path


def as_others_read(path: Path) -> dict[str, list[dict[str, Any]]]:
    """JSON messages by topic, by the library's own reader of indexed files."""
    found: dict[str, list[dict[str, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert schema.name.startswith("foxglove." if channel.topic in FIELDS else "")
            found.setdefault(channel.topic, []).append(json.loads(message.data))
    return found


AT = {"timestamp", "frame_id"}
FIELDS = {
    "/map": AT | {"pose", "column_count", "cell_size", "row_stride", "cell_stride", "fields",
                  "data"},
    "/tf": {"timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation"},
    "/scan": AT | {"pose", "start_angle", "end_angle", "ranges", "intensities"},
    "/pose": AT | {"pose"},
    "/places": {"deletions", "entities"},
}  # fmt: skip
"""The fields of Foxglove's schemas that its panels need."""


def test_messages_have_the_schemas_and_fields_that_foxglove_reads(run: Path) -> None:
    found = as_others_read(run)
    for topic, fields in FIELDS.items():
        assert fields <= found[topic][0].keys(), topic
    assert found["/scan"][1]["timestamp"] == {"sec": 0, "nsec": 10**8}
    assert len(base64.b64decode(found["/map"][0]["data"])) == world("cross").map.cells.size
    (entity,) = found["/places"][1]["entities"]
    assert AT | {"id", "lifetime", "frame_locked", "metadata"} <= entity.keys()
    for kind in ("arrows", "cylinders", "texts"):
        assert [one["color"].keys() for one in entity[kind]] == [set("rgba")] * 2


def test_the_layout_for_foxglove_draws_topics_of_the_file(run: Path) -> None:
    panels = json.loads((ROOT / "deploy" / "foxglove.json").read_text())["configById"]
    topics = as_others_read(run)
    assert panels["3D!map"]["topics"].keys() <= topics.keys()
    first, second, elsewhere = (one["value"] for one in panels["Plot!probabilities"]["paths"])
    assert elsewhere.removeprefix("/belief.") in topics["/belief"][1]
    for number, path in enumerate((first, second)):
        found = topics["/belief"][1]["hypotheses"][number]
        assert path.removeprefix(f"/belief.hypotheses[{number}].") in found


def test_the_mcap_library_reads_scan_places_and_map(run: Path) -> None:
    found = as_others_read(run)
    counts = {topic: len(messages) for topic, messages in found.items()}
    each_step = ("/scan", "/scan_1", "/places", "/belief", "/events")
    assert counts == dict.fromkeys(each_step, STEPS) | {
        "/map": 1, "/pose": STEPS - 1, "/tf": STEPS + STEPS - 1,
    }  # fmt: skip
    assert found["/scan"][3]["ranges"] == [2.0, 0.0, 0.0, 3.1]
    assert np.float32(found["/scan_1"][0]["ranges"][1]) == np.float32(1.0 / 3.0)
    assert found["/scan_1"][0]["pose"]["position"] == {"x": -0.4, "y": 0.0, "z": 0.0}
    assert [len(one["entities"][0]["cylinders"]) for one in found["/places"][:2]] == [0, 2]
    assert [text["text"] for text in found["/places"][1]["entities"][0]["texts"]] == ["45 %"] * 2
    variances = np.linalg.eigvalsh([[0.4, 0.1], [0.1, 0.3]])
    size = found["/places"][1]["entities"][0]["cylinders"][0]["size"]
    assert (size["y"], size["x"]) == pytest.approx(tuple(4.0 * np.sqrt(variances)), abs=1e-4)
    (grid,) = found["/map"]
    assert (grid["column_count"], grid["cell_size"]["x"]) == (
        world("cross").map.cells.shape[1], world("cross").map.cell_m,
    )  # fmt: skip


TAG = Landmark(name="exit", x=1.0, y=2.0, sigma=0.1)


def test_the_map_is_read_again_and_a_large_one_coarser(run: Path, tmp_path: Path) -> None:
    assert run.stat().st_mode & 0o777 == 0o600, "only the owner may see where the robot was"
    ground = world("cross").map
    assert last_map(run).digest == load_map(run).digest == ground.digest
    small = tmp_path / "small.mcap"
    with RunLog(small) as log:
        log.on_map(ground.with_landmarks([TAG]), 0, ground.cells.size // 4)
    coarse = last_map(small)
    assert coarse.landmarks == (TAG,)
    assert coarse.cell_m == 2 * ground.cell_m
    assert coarse.cells.shape == tuple(-(-side // 2) for side in ground.cells.shape)
    rows, cols = np.nonzero(ground.cells == 1)
    assert np.all(coarse.cells[rows // 2, cols // 2] == 1), "no wall is lost"


def test_a_run_is_a_recording_with_every_bit_of_scans_and_odometry(run: Path) -> None:
    recording = open_recording(run, BridgeSettings())
    assert recording.skipped == ()
    lasers = [one for one in recording.readings if isinstance(one, LaserReading)]
    assert {one.laser for one in lasers} == {"scan", "scan_1"}
    assert len(lasers) == 2 * STEPS
    behind = next(one for one in lasers if one.laser == "scan_1")
    assert behind.ranges == step_scan(0).others[0].ranges
    assert behind.robot_from_laser == (-0.4, 0.0, np.pi)
    poses = {one.stamp_ns: one.odom_from_robot for one in odometry_of(recording)}
    for seen in map(step_scan, range(STEPS)):
        assert poses.pop(seen.stamp_ns) == seen.odom_from_robot
    assert not poses
    again = steps_of(recording, BridgeSettings(), world("cross").map.digest)
    made = [(step.step, step.stamp_ns, step.odom_from_robot) for step in again]
    seen_steps = map(step_scan, range(STEPS))
    assert made == [(seen.step, seen.stamp_ns, seen.odom_from_robot) for seen in seen_steps]


def test_the_transforms_of_the_file_lead_to_the_best_place(run: Path) -> None:
    """As a viewer draws the robot: map from odom, of the last belief, and odom from robot."""
    tf = as_others_read(run)["/tf"]
    links = {(one["parent_frame_id"], one["child_frame_id"]): one for one in tf}
    map_from_odom, odom_from_robot = (
        (link["translation"]["x"], link["translation"]["y"],
         2.0 * np.arctan2(link["rotation"]["z"], link["rotation"]["w"]))
        for link in (links["map", "odom"], links["odom", "base_link"])
    )  # fmt: skip
    expected = np.array(belief(1, 4).hypotheses[0].pose)
    found = compose(np.array(map_from_odom), np.array(odom_from_robot))
    # Angles are drawn to five digits; the robot is 3.3 m from the origin of odometry.
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_a_truncated_file_is_read_up_to_its_last_complete_chunk(run: Path, tmp_path: Path) -> None:
    data, cut = run.read_bytes(), tmp_path / "cut.mcap"
    log = RunLogReader(run)
    whole = list(log.messages())
    assert not log.cut
    read_last = 0
    for length in range(0, len(data), 97):
        cut.write_bytes(data[:length])
        log = RunLogReader(cut)
        read = list(log.messages())
        assert read == whole[: len(read)]
        assert log.cut
        assert len(read) >= read_last
        read_last = len(read)
    assert read_last == len(whole)


def test_changed_bytes_of_a_file_are_never_read_as_messages(run: Path, tmp_path: Path) -> None:
    rng, data = random.Random(1), run.read_bytes()
    right, path = list(RunLogReader(run).messages()), tmp_path / "broken.mcap"
    for _ in range(300):
        broken = bytearray(data)
        broken[rng.randrange(60, len(data))] ^= rng.randrange(1, 256)
        path.write_bytes(broken)
        read = list(RunLogReader(path).messages())
        assert read == right[: len(read)]


@pytest.mark.parametrize("data", [b"P5 800 600 255", b"MCLFLY2\n" + bytes(100)])
def test_a_file_that_is_not_a_run_log_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(data)
    assert not is_run_log(path)
    with pytest.raises(RecordingError, match="is not an MCAP file"):
        list(RunLogReader(path).messages())
    with pytest.raises(RecordingError, match="no such file"):
        list(RunLogReader(tmp_path / "none").messages())


def test_another_mcap_file_is_refused_and_a_bomb_never_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bomb("ros2"))
    assert not is_run_log(path)
    with pytest.raises(RecordingError, match="not written by clustermcl"):
        list(RunLogReader(path).messages())
    path.write_bytes(bomb("clustermcl"))
    assert is_run_log(path)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    log = RunLogReader(path)
    assert list(log.messages()) == []
    assert "unpacks to more than" in log.cut
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 200_000


def test_endless_topics_messages_and_runs_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each file has some kilobytes, and unpacks chunk by chunk to more than any memory."""
    path = tmp_path / "run.mcap"
    with RunLog(path) as log:
        for number in range(400):
            log.write("/" + chr(97 + number % 26) * 60_000 + str(number), {}, 0)
    names = RunLogReader(path)
    assert 200 < len(list(names.messages())) < 400
    assert "names of topics are too long" in names.cut
    with RunLog(path) as log:
        log.write(BELIEF, msgspec.Raw(b"[" + b"0," * 2**23 + b"0]"), 0)
    long = RunLogReader(path)
    assert list(long.messages()) == []
    assert "a message of /belief is too long" in long.cut
    write_run(path)
    monkeypatch.setattr(run_log, "MAX_PLAYBACK_BYTES", 10_000)
    with pytest.raises(RecordingError, match="too long unpacked"):
        open_recording(path, BridgeSettings())


def test_a_full_disk_is_reported_in_one_line() -> None:
    log = RunLog(Path("/dev/full"))
    log.write(BELIEF, belief(1, 4), 0)
    with pytest.raises(OutputError, match="No space left"):
        log.flush()
    log.abandon()
