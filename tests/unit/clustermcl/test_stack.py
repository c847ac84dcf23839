import os
import signal
from pathlib import Path

import pytest

from clustermcl.commands import up
from clustermcl.commands.stack import ProcessEndedError, meeting_in, temporary_folder
from clustermcl.link.configuration import check_endpoint
from clustermcl.runtime.folders import claimed
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.supervisor import ChildExit


@pytest.mark.parametrize(
    ("code", "said"), [(2, "KeyError: 'c3'"), (1, "exit code 1: Key"), (-9, "SIGKILL: Key")]
)
def test_an_exit_is_told_in_the_words_of_the_process_or_by_its_code(code: int, said: str) -> None:
    ended = ChildExit("worker", code, restart_in_s=0.1, last_words="KeyError: 'c3'")
    assert said in str(ProcessEndedError(ended))
    assert ("worker process" in str(ProcessEndedError(ended))) == (code != 2)


def test_the_socket_path_fits_even_if_the_temporary_folder_has_a_long_path(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    deep = tmp_path / ("d" * 100)
    deep.mkdir()
    monkeypatch.setattr("tempfile.tempdir", os.fspath(deep))
    with temporary_folder() as folder:
        check_endpoint(meeting_in(folder, Settings()).zenoh.router)


def test_the_temporary_folder_is_claimed_so_that_no_cleaner_removes_old_files_in_it() -> None:
    with temporary_folder() as folder, claimed(folder) as is_free:
        assert not is_free


def test_a_killed_check_of_the_settings_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(up, "_check", lambda _: os.kill(os.getpid(), signal.SIGKILL))
    with pytest.raises(ProcessEndedError, match="settings check process ended with SIGKILL"):
        up.up(robot=None, router=None)


def test_refused_settings_end_the_command(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        up.up(robot=None, router=None)  # without a map
    assert ended.value.code == 2
    assert "bridge.map is empty" in capfd.readouterr().err
