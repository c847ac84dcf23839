import json
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clustermcl.belief.outcome import belief_after
from clustermcl.evaluation.course import Case, SimulatedRobot
from clustermcl.evaluation.run import Run
from clustermcl.link.metrics_of_status import StatusCollector
from clustermcl.recordings.run_log import RunLog, last_map
from clustermcl.runtime.settings import Settings
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.view.frames import map_frame
from clustermcl.view.picture import Picture
from clustermcl.view.recorded_run import RecordedRun
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.recorder.recorded import Recordings
from tests.unit.recordings.test_run_log import STEPS, step_scan, write_run
from tests.unit.view.messages import belief, map_message, status


def read(run: RecordedRun) -> RecordedRun:
    while run.read_for(0.01):
        pass
    return run


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a robot with two lasers; odometry lies between a step and its belief."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    write_run(path)
    return path


def live(step: int) -> Picture:
    """What the page of the running system showed."""
    picture = Picture({})
    seen = step_scan(step)
    picture.on_scan(seen)
    at = {"stamp_ns": seen.stamp_ns, "odom_from_robot": seen.odom_from_robot}
    picture.on_belief(msgspec.structs.replace(belief(step, 4, 7), **at))
    return picture


def past(run: RecordedRun, step: int) -> dict[str, Any]:
    frames = run.picture.past(step)
    return {topic: json.loads(bytes(frames[topic])) for topic in frames if topic != "events"}


def test_all_steps_are_shown(file: Path) -> None:
    shown = read(RecordedRun(file, None)).picture.everything()
    assert shown["system"]["link"] == "finished"
    assert shown["system"]["robot"] == "run"
    assert not shown["system"]["commands"]
    assert [json.loads(bytes(row))[0] for row in shown["history"]["rows"]] == list(range(STEPS))
    assert shown["map"]["digest"] == world("cross").map.digest


@pytest.mark.parametrize("step", [1, STEPS - 1])
def test_a_recorded_step_shows_the_frames_of_the_live_page(file: Path, step: int) -> None:
    was = json.loads(msgspec.json.encode(live(step).everything()["step"]))
    shown = past(read(RecordedRun(file, None)), step)["step"]
    assert len(shown["scan"]) == 8  # two of the first laser's four beams, both of the second's
    assert shown == was


def test_a_flight_recording_is_shown_from_file_to_file(tmp_path: Path) -> None:
    """Of 30 steps in a room with two places that look alike, in several files."""
    living = Living(symmetric_room(), made=Recordings(tmp_path, 1_000_000).make)
    for step in range(30):
        living.drive(step)
    assert len(list(tmp_path.iterdir())) > 1
    flight = read(RecordedRun(tmp_path, map_message()))
    shown = flight.picture.everything()
    assert shown["step"]["step"] == 29
    assert [json.loads(bytes(row))[0] for row in shown["history"]["rows"]] == list(range(30))
    frames = past(flight, 20)
    step, pose = frames["step"], frames["pose"]
    assert (step["step"], pose["step"]) == (20, 20)
    assert len(step["places"]) >= 2
    assert len(step["scan"]) > 20
    assert pose["pose"] == step["places"][0]["pose"]
    assert any(event["kind"] == "began" for event in flight.picture.past(20)["events"])


def test_a_given_map_is_drawn_in_place_of_that_in_the_log(file: Path) -> None:
    run = read(RecordedRun(file, map_message()))
    assert run.picture.everything()["map"]["rows"] == 2
    assert run.room.map[0] == "d1"


def test_the_recording_of_a_killed_recorder_is_shown_up_to_its_end(
    file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    shown = read(RecordedRun(cut, None)).picture.everything()
    assert 0 < shown["step"]["step"] < STEPS - 1
    assert "is cut off or damaged" in caplog.text


def test_a_recorded_building_is_drawn_in_its_atlas(tmp_path: Path) -> None:
    case = Case(robot=SimulatedRobot(world="tower"), updates=3)
    course, steps = Run(case=case, seed=1, settings=Settings()).begun()
    file = tmp_path / "run.mcap"
    with RunLog(file) as log:
        log.on_map(course.map, 0)
        for scan, outcome, _ in islice(steps, 3):
            belief = belief_after(scan, outcome, "coordinator")
            log.on_scan(scan, scan.stamp_ns)
            log.on_belief(belief, scan.stamp_ns)
    assert last_map(file).floors == course.map.floors
    run = RecordedRun(file, None)
    run.read_for(60.0)
    shown = run.picture.everything()
    assert belief.floor == "ground"
    best = outcome.hypotheses[0]
    assert shown["step"]["places"][0]["pose"] == best.pose
    assert shown["pose"].pose == best.pose
    assert msgspec.to_builtins(shown["map"]["floors"])[0]["name"] == "ground"
    assert run._map is not None
    assert map_frame(run._map)["floors"] == course.map.floors.floors


def test_floors_are_metrics() -> None:
    told = msgspec.structs.replace(status(), floors={"ground": 0.9, "third": 0.1})
    samples = [s for m in StatusCollector(lambda: told, "r").collect() for s in m.samples]
    floors = {s.labels["floor"]: s.value for s in samples if "floor_probability" in s.name}
    assert floors == told.floors
