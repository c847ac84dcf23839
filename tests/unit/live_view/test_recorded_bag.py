"""A recorded bag on the page: the same steps, scans and places as were live."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from grid_maps.map_message import to_message
from live_view.picture import Picture
from live_view.recorded_bag import bag_run
from live_view.recorded_run import RecordedRun
from protocol.arrays import ArrayBlob
from protocol.errors import RecordingError
from protocol.steps import LaserBeams, OdometryReading, Scan
from recordings.bag_file import BagFile
from recordings.map_file import load_map
from recordings.run_recorder import RunRecorder
from robot_simulator.worlds.catalogue import world
from tests.unit.live_view.messages import belief, scan

STEPS = 12


def stamped(step: int) -> Scan:
    beams = LaserBeams(
        robot_from_laser=(-0.4, 0.0, np.pi), angle_min_rad=0.0, angle_step_rad=0.5,
        range_max_m=10.0, ranges=ArrayBlob.of(np.array([1.0]), "float32"),
    )  # fmt: skip
    made = scan(step, [2.0, 11.0, np.nan, 3.0])
    return msgspec.structs.replace(made, stamp_ns=step * 10**8, others=(beams,))


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a robot with two lasers; beliefs come after the odometry that follows their step."""
    path = tmp_path_factory.mktemp("bag") / "run.mcap"
    with RunRecorder.to(path) as recorder:
        recorder.on_map(world("cross").map, 0)
        for step in range(STEPS):
            seen = stamped(step)
            recorder.on_scan(seen)
            later = seen.stamp_ns + 10**7
            recorder.on_odometry(
                OdometryReading(sender="r", stamp_ns=later, odom_from_robot=(0.0, 0.0, 0.0))
            )
            told = belief(step, 4, 7) if step else belief(step)
            recorder.on_belief(msgspec.structs.replace(told, stamp_ns=seen.stamp_ns))
    return path


@pytest.fixture(scope="module")
def run(file: Path) -> RecordedRun:
    with BagFile(file, RecordingError) as bag:
        made = RecordedRun(bag_run(bag, file), to_message(load_map(file), "r"), {"robot": "run"})
        while made.replay_for(0.01):
            pass
    return made


def live(step: int) -> Picture:
    """What the page of the running system showed."""
    picture = Picture({})
    picture.on_scan(stamped(step))
    told = belief(step, 4, 7)
    picture.on_belief(msgspec.structs.replace(told, stamp_ns=step * 10**8))
    return picture


def past(run: RecordedRun, step: int) -> dict[str, Any]:
    frames = run.picture.past(step)
    return {topic: json.loads(bytes(frames[topic])) for topic in frames if topic != "events"}


def test_all_steps_are_shown(run: RecordedRun) -> None:
    shown = run.picture.everything()
    assert shown["system"]["link"] == "finished"
    assert [json.loads(bytes(row))[0] for row in shown["history"]["rows"]] == list(range(STEPS))
    assert shown["map"]["digest"] == world("cross").map.digest


@pytest.mark.parametrize("step", [1, STEPS - 1])
def test_a_step_is_what_the_live_page_showed(run: RecordedRun, step: int) -> None:
    was = json.loads(msgspec.json.encode(live(step).everything()["step"]))
    shown = past(run, step)["step"]
    assert shown["scan"] == was["scan"]
    assert len(shown["scan"]) == 6  # two of the first laser's four beams, one of the second's
    assert shown == was


def test_drawn_poses_are_particles_of_the_place_they_were_drawn_from(run: RecordedRun) -> None:
    frames = past(run, STEPS - 1)
    for cluster in (4, 7):
        cloud = frames[f"cloud {cluster}"]
        assert cloud["step"] == 10
        x_m = np.array(cloud["points"][::3]) / 100.0
        assert len(x_m) > 100
        assert abs(np.median(x_m) - cluster) < 0.2  # of some 220, with a deviation of 0.6 m


def test_a_bag_without_beliefs_is_refused_with_what_to_do_instead(tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    with RunRecorder.to(path) as recorder:
        recorder.on_scan(stamped(0))
    with (
        BagFile(path, RecordingError) as bag,
        pytest.raises(RecordingError, match="demo --view --recording"),
    ):
        bag_run(bag, path)


def test_what_a_killed_recorder_has_written_is_shown(file: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size * 85 // 100])
    with BagFile(cut, RecordingError) as bag:
        told = RecordedRun(bag_run(bag, cut), None, {"robot": "run"})
        while told.replay_for(0.01):
            pass
        assert bag.left_out
    assert told.picture.everything()["step"]["step"] < STEPS - 1
