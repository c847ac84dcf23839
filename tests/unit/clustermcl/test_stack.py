import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from clustermcl.stack import ProcessEndedError, meeting_in, temporary_folder
from process_runtime.settings import RobotSettings, Settings
from process_runtime.supervisor import ChildExit
from zenoh_link.configuration import check_endpoint


@pytest.fixture
def short_base() -> Iterator[Path]:
    """A temporary folder whose path leaves room for a socket's."""
    with tempfile.TemporaryDirectory(prefix="mcl-") as path:
        yield Path(path)


def test_a_startup_error_quotes_the_message_of_its_process() -> None:
    words = "sensor_bridge: map.yaml: no such file"
    refused = ChildExit("sensor_bridge", 2, restart_in_s=None, last_words=words)
    assert str(ProcessEndedError(refused)) == words


@pytest.mark.parametrize(
    ("code", "how"), [(1, "exit code 1"), (-9, "SIGKILL"), (-11, "SIGSEGV"), (0, "exit code 0")]
)
def test_any_other_exit_names_the_process_and_its_exit_code(code: int, how: str) -> None:
    ended = ChildExit("worker", code, restart_in_s=0.1, last_words="KeyError: 'c3'")
    assert str(ProcessEndedError(ended)) == f"the worker process ended with {how}: KeyError: 'c3'"


def test_the_socket_path_fits_even_if_the_temporary_folder_has_a_long_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    monkeypatch.setattr("tempfile.tempdir", os.fspath(deep))
    with temporary_folder() as folder:
        check_endpoint(meeting_in(folder, Settings()).zenoh.router)


def test_a_router_in_a_folder_changes_only_the_endpoint() -> None:
    settings = Settings(seed=5, robot=RobotSettings(name="r2"))
    met = meeting_in(Path("/tmp/x"), settings)
    assert met.zenoh.router == "unixsock-stream//tmp/x/router.sock"
    assert (met.seed, met.robot, met.bridge) == (5, settings.robot, settings.bridge)


def left_behind(base: Path, name: str, *, age_s: float) -> Path:
    """A folder as a killed process leaves it."""
    folder = base / name
    folder.mkdir()
    (folder / "lock").touch()
    (folder / "router.log").write_text("x")
    long_ago = time.time() - age_s
    os.utime(folder, (long_ago, long_ago))
    return folder


def test_folders_of_killed_processes_are_removed_by_the_next_one(
    monkeypatch: pytest.MonkeyPatch, short_base: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", os.fspath(short_base))
    orphan = left_behind(short_base, "clustermcl-orphan", age_s=60.0)
    newborn = left_behind(short_base, "clustermcl-newborn", age_s=0.0)
    foreign = left_behind(short_base, "somebody-elses", age_s=60.0)
    with temporary_folder() as first:
        long_ago = time.time() - 60.0
        os.utime(first, (long_ago, long_ago))
        with temporary_folder() as second:
            assert sorted(short_base.iterdir()) == sorted([first, newborn, second, foreign])
    assert not orphan.exists()
    assert sorted(short_base.iterdir()) == sorted([newborn, foreign])
