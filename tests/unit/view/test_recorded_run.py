import json
import subprocess
import sys
from itertools import islice
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from clustermcl.belief.outcome import belief_after
from clustermcl.evaluation.run import Case, Run, SimulatedRobot
from clustermcl.protocol.errors import ClusterMclError, RecordingError
from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.run_log import RunLog, last_map
from clustermcl.runtime.settings import Settings
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.view.admission import Address
from clustermcl.view.picture import Picture
from clustermcl.view.recorded_run import RecordedRun, view_recording
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.recorder.recorded import Recordings
from tests.unit.recordings.test_run_log import STEPS, step_scan, write_run
from tests.unit.view.messages import belief


def read(run: RecordedRun) -> RecordedRun:
    while run.read_for(0.01):
        pass
    return run


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of a robot with two lasers; odometry lies between a step and its belief."""
    path = tmp_path_factory.mktemp("log") / "run\udcff.mcap"  # its name is not UTF-8
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


def test_all_steps_are_shown_on_the_recorded_map(file: Path) -> None:
    shown = read(RecordedRun(file)).picture.everything()
    assert shown["system"]["link"] == "finished"
    assert shown["system"]["robot"] == "run\\udcff"
    assert not shown["system"]["commands"]
    assert [json.loads(bytes(row))[0] for row in shown["history"]["rows"]] == list(range(STEPS))
    assert shown["map"]["digest"] == world("cross").map.digest


def test_of_a_folder_of_runs_one_must_be_named(file: Path) -> None:
    with pytest.raises(RecordingError, match=f"name one of .*{file.parent.name}"):
        view_recording(file.parent.parent, Address("", 0))


@pytest.mark.parametrize("step", [1, STEPS - 1])
def test_a_recorded_step_shows_the_frames_of_the_live_page(file: Path, step: int) -> None:
    was = json.loads(msgspec.json.encode(live(step).everything()["step"]))
    shown = past(read(RecordedRun(file)), step)["step"]
    assert len(shown["scan"]) == 8  # two of the first laser's four beams, both of the second's
    assert shown == was


def test_a_flight_recording_is_shown_from_file_to_file(tmp_path: Path) -> None:
    """Of 30 steps in a room with two places that look alike, in several files."""
    Living(symmetric_room(), made=Recordings(tmp_path, 1_000_000).make).drive_on(30)
    assert len(list(tmp_path.iterdir())) > 1
    flight = read(RecordedRun(tmp_path))
    history = flight.picture.everything()["history"]
    assert [json.loads(bytes(row))[0] for row in history["rows"]] == list(range(30))
    step, pose = (past(flight, 20)[topic] for topic in ("step", "pose"))
    assert (step["step"], pose["step"]) == (20, 20)
    assert len(step["places"]) >= 2
    assert len(step["scan"]) > 20
    assert pose["pose"] == step["places"][0]["pose"]
    assert any(event["kind"] == "began" for event in flight.picture.past(20)["events"])


def test_the_recording_of_a_killed_recorder_is_shown_up_to_its_end(
    file: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    shown = read(RecordedRun(cut)).picture.everything()
    assert 0 < shown["step"]["step"] < STEPS - 1
    assert "is cut off or damaged" in caplog.text


def test_without_rerun_the_extra_is_named(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ClusterMclError, match=r"pip install 'clustermcl\[rerun\]'"):
        view_recording(file, Address("", 0), save_file=tmp_path / "run.rrd")


@pytest.fixture(scope="module")
def building(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, GridMap, PoseTuple]:
    """A recording, its map, and the best pose of the last belief in the map's atlas."""
    case = Case(robot=SimulatedRobot(world="tower"), updates=3)
    course, steps = Run(case=case, seed=1, settings=Settings()).begun()
    file = tmp_path_factory.mktemp("tower") / "run.mcap"
    with RunLog(file) as log:
        log.on_map(course.map, 0)
        for scan, outcome, _ in islice(steps, 3):
            log.on_scan(scan, scan.stamp_ns)
            log.on_belief(belief_after(scan, outcome, "coordinator"), scan.stamp_ns)
    return file, course.map, outcome.hypotheses[0].pose


def test_a_recorded_building_is_drawn_in_its_atlas(
    building: tuple[Path, GridMap, PoseTuple],
) -> None:
    file, grid_map, best = building
    assert last_map(file).floors == grid_map.floors
    run = read(RecordedRun(file))
    shown = run.picture.everything()
    assert shown["pose"].floor == "ground"
    assert shown["step"]["places"][0]["pose"] == best
    assert shown["pose"].pose == best
    assert shown["map"]["floors"] == grid_map.floors.floors


def test_a_run_is_written_for_reruns_viewer(
    building: tuple[Path, GridMap, PoseTuple], tmp_path: Path
) -> None:
    pytest.importorskip("rerun", reason="the extra rerun is not installed; .ci/run installs it")
    file, _, (x, y, _) = building
    saved = tmp_path / "run.rrd"
    view_recording(file, Address("", 0), save_file=saved)
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-vvv", saved],
        capture_output=True, text=True, timeout=60, check=True,
    ).stdout  # fmt: skip
    for entity in ("map", "scan", "places", "places/spread", "probability/elsewhere", "state"):
        assert f" /{entity} " in printed
    assert f"[[{np.float32(x)!s}, {np.float32(y)!s}, " in printed  # as in the atlas
    assert "Scalars:scalars" in printed
