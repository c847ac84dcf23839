import os
import re
from datetime import datetime, timedelta
from pathlib import Path

import msgspec
import pytest
from typer.testing import CliRunner, Result

from clustermcl.belief import bayes_update
from clustermcl.commands import replay
from clustermcl.commands.command import app
from clustermcl.coordinator.events import WorkerChanged
from clustermcl.coordinator.recorder.records import Head, RecordedEvent
from clustermcl.coordinator.recorder.ring import files_in
from clustermcl.filter.laser.beam_fits import decoded
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.protocol.answers import SetPose
from clustermcl.protocol.errors import ClusterMclError, SettingsError
from clustermcl.recordings.run_log import RunLog
from clustermcl.simulator.worlds.catalogue import world
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.recorder.recorded import VERSION, Recordings, head, write_file

GIVEN = SetPose(sender="set-pose of anna@laptop", command_id="1", pose=(2.0, 2.0, 0.5))


@pytest.fixture(scope="module")
def model() -> SensorModel:
    return symmetric_room()


@pytest.fixture(scope="module")
def recording(model: SensorModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten steps, and five more of a second coordinator; a pose is given after the fourth."""
    folder = tmp_path_factory.mktemp("flight")
    living = Living(model, made=Recordings(folder).make)
    living.drive_on(4).command(GIVEN)
    living.drive_on(10).revive()
    living.drive_on(15)
    return folder


@pytest.fixture(autouse=True)
def _of_the_recordings_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "VERSION", VERSION)


def run(*words: object) -> Result:
    return CliRunner().invoke(app, ["replay", *map(str, words)])


def complaint(*words: object) -> str:
    result = run(*words)
    assert isinstance(result.exception, ClusterMclError)  # `main` makes a line and code 2 of it
    text = str(result.exception)
    assert "\n" not in text
    return text


def test_replay_prints_what_happened_as_text(recording: Path) -> None:
    result = run(recording)
    *timed, last = result.stdout.splitlines()
    assert result.exit_code == 0
    assert all(datetime.fromisoformat(line[:23]) for line in timed)
    lines = [line[24:] for line in timed]
    assert "worker joined: w0" in lines
    assert "coordinator coordinator, term 1: begins empty" in lines
    taken_over = r"coordinator coordinator, term \d+: takes over after step 9"
    assert any(re.fullmatch(taken_over, line) for line in lines)
    assert any(line.startswith("step 14: ") for line in lines)
    assert any(" found by the first search " in line for line in lines)
    given = "pose given: x 2.00 m  y 2.00 m  heading 28.6 deg  +-0.50 m, by set-pose of anna@laptop"
    assert given in lines
    assert last == "17 beliefs, 2 coordinators: all as recorded, bit for bit"


def test_replay_prints_only_the_requested_steps_or_time(recording: Path) -> None:
    *whole, last = run(recording).stdout.splitlines()
    lines = run(recording, "--from", 3, "--to", 6).stdout.splitlines()
    beliefs = [line[24:] for line in lines if line[24:].startswith("step ")]
    steps = dict.fromkeys(line.partition(":")[0] for line in beliefs)  # step 3 twice: a command
    assert list(steps) == [f"step {step}" for step in range(3, 7)]
    assert lines[-1] == last
    at = datetime.fromisoformat(whole[10][:23])
    times = [(datetime.fromisoformat(line[:23]) - at).total_seconds() for line in whole]
    for first in (0, 11):  # with its date, or on any day
        before = str(datetime.fromisoformat(whole[30][:23]) - timedelta(microseconds=1))
        words = ("--from", whole[10][first:23], "--to", before[first:])
        expected = [line for line in whole if whole[10][:23] <= line[:23] < whole[30][:23]]
        assert run(recording, *words).stdout.splitlines() == [*expected, last]
        around = [line for line, s in zip(whole, times, strict=True) if abs(s) <= 5.0]
        assert run(recording, "--at", whole[10][first:23]).stdout.splitlines() == [*around, last]
    assert 0 < len(expected) < len(whole)


def test_replay_refuses_a_time_that_is_none(recording: Path) -> None:
    for words in (("--at", "noon"), ("--at", "11:45", "--from", "3")):
        assert isinstance(run(recording, *words).exception, SettingsError)


def test_replay_leaves_out_improbable_places(recording: Path) -> None:
    lines, fewer = (run(recording, "--above", p).stdout.splitlines() for p in (0, 1))
    places = [line for line in lines if re.search(r": place \d+ .* \(", line)]
    assert [line for line in lines if line not in places] == fewer
    assert places


def test_a_file_of_the_recording_or_the_folder_above_will_do(
    recording: Path, tmp_path: Path
) -> None:
    whole = run(recording).stdout
    assert run(files_in(recording)[-1]).stdout == whole
    (tmp_path / "r1").symlink_to(recording)
    assert run(tmp_path).stdout == whole


def test_a_belief_that_differs_has_exit_code_1(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the filter had been changed since."""
    monkeypatch.setattr(
        bayes_update, "decoded", lambda fits: (decoded(fits)[0] ** 2, decoded(fits)[1])
    )
    result = run(recording)
    assert result.exit_code == 1
    assert "differs from the recorded belief" in result.stdout
    assert result.stdout.splitlines()[-1].endswith("differ from the recorded ones")


def test_folders_without_a_recording_are_refused_in_one_line(tmp_path: Path) -> None:
    assert "no such folder" in complaint(tmp_path / "nowhere")
    assert "it contains no flight recording" in complaint(tmp_path)
    for robot in ("r1", "r2"):
        (tmp_path / robot).mkdir()
        write_file(tmp_path / robot / f"{7:017d}-000000.mcap", head())
    assert "several flight recordings: name one of r1, r2" in complaint(tmp_path)


@pytest.mark.parametrize(
    ("begin", "problem"),
    [
        (head("0.9"), "recorded by version 0.9, this is test"),
        (msgspec.structs.replace(head(), snapshot=b"nonsense"), "not a coordinator's snapshot"),
    ],
)
def test_files_that_cannot_be_read_are_refused_in_one_line(
    tmp_path: Path, begin: Head, problem: str
) -> None:
    write_file(tmp_path / f"{7:017d}-000000.mcap", begin)
    assert problem in complaint(tmp_path)


def test_a_run_that_the_page_shows_is_named(tmp_path: Path) -> None:
    with RunLog(tmp_path / f"{7:017d}-000000.mcap") as log:
        log.on_map(world("cross").map, 0)
    said = complaint(tmp_path)
    assert f"no events of a coordinator; show it with: clustermcl view {tmp_path}" in said


def test_a_truncated_end_is_reported_and_the_rest_replayed(recording: Path, tmp_path: Path) -> None:
    for file in files_in(recording):
        (tmp_path / file.name).write_bytes(file.read_bytes()[:-10])
    (tmp_path / f"{9**17:017d}-000000.mcap").touch()  # killed before it wrote
    result = run(tmp_path)
    assert result.exit_code == 0
    assert result.stdout.count("cut off: ") == 3
    assert "1970-01-01 00:00:00" not in result.stdout


def test_a_named_pipe_in_the_folder_is_ignored(recording: Path) -> None:
    pipe = recording / f"{8:017d}-000000.mcap"
    os.mkfifo(pipe)
    try:
        assert run(recording).exit_code == 0
    finally:
        pipe.unlink()


def test_a_failure_of_the_replayed_coordinator_is_one_line(tmp_path: Path) -> None:
    """A bug that was recorded, or a forged file."""
    path = tmp_path / f"{7:017d}-000000.mcap"
    write_file(path, head(), RecordedEvent(1, WorkerChanged("never seen", "returned")))
    assert "the coordinator fails at event 1: KeyError: 'never seen'" in complaint(tmp_path)


def test_replay_says_why_a_place_rose_or_fell(recording: Path) -> None:
    lines = run(recording, "--why", "c0").stdout.splitlines()
    assert any(re.search(r"step 1: place 0 \d+\.\d -> \d+\.\d %; log odds", line) for line in lines)
    assert "no longer tracked" in lines[-2], "a pose was given after step 3"
    assert re.fullmatch(r"steps 0 to \d+, log odds in nat: .*scan [+-]\d.*", lines[-1])
    elsewhere = run(recording, "--why", "elsewhere", "--from", 2, "--to", 4).stdout.splitlines()
    assert len(elsewhere) == 5, "steps 2 to 4, the given pose, and the sum"


def test_a_place_that_is_not_recorded_is_named(recording: Path, tmp_path: Path) -> None:
    assert "contains place 77" in complaint(recording, "--why", "77")
    assert "--why: 'b3' is no place" in complaint(recording, "--why", "b3")
    assert "no flight recording" in complaint(tmp_path, "--why", "c0")
