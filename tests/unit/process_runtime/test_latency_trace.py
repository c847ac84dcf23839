"""Stamps of what happened when."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from process_runtime.latency_trace import mark, start_trace
from protocol.answers import Relocalize
from protocol.errors import InputFileError
from protocol.steps import TruePose


@pytest.fixture(autouse=True)
def _off_afterwards() -> Iterator[None]:
    yield
    start_trace("", "test")


def pose_of(step: int) -> TruePose:
    return TruePose(sender="robot", step=step, map_from_robot=(0.0, 0.0, 0.0))


def lines(folder: Path) -> list[str]:
    return [line for file in sorted(folder.iterdir()) for line in file.read_text().splitlines()]


def test_nothing_is_written_unless_a_folder_is_named(tmp_path: Path) -> None:
    start_trace("", "test")
    for step in range(100):
        mark("put", pose_of(step))
    assert not any(tmp_path.iterdir())


def test_a_stamp_has_step_event_sender_and_time(tmp_path: Path) -> None:
    start_trace(str(tmp_path / "new"), "test")
    for step in range(64):
        mark("put", pose_of(step), 1_000 + step)
    assert lines(tmp_path / "new")[:2] == [
        "0 TruePose.put robot 1000",
        "1 TruePose.put robot 1001",
    ]


def test_times_go_up(tmp_path: Path) -> None:
    start_trace(str(tmp_path), "test")
    for step in range(64):
        mark("put", pose_of(step))
    times = [int(line.split()[3]) for line in lines(tmp_path)]
    assert len(times) == 64
    assert times == sorted(times)


def test_a_message_of_no_step_leaves_no_stamp(tmp_path: Path) -> None:
    start_trace(str(tmp_path), "test")
    for _ in range(200):
        mark("put", Relocalize(sender="person", command_id="1"))
    assert lines(tmp_path) == []


def test_a_folder_that_cannot_be_is_said_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputFileError, match="trace_folder"):
        start_trace(str(tmp_path / "file" / "below"), "test")
