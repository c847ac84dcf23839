import os
import signal

import pytest

from clustermcl.commands.stack import ProcessEndedError
from clustermcl.commands.up import run_up
from clustermcl.runtime.settings import Settings


def test_a_killed_check_of_the_settings_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "clustermcl.commands.up._check", lambda _: os.kill(os.getpid(), signal.SIGKILL)
    )
    with pytest.raises(ProcessEndedError, match="settings check process ended with SIGKILL"):
        run_up(Settings())


def test_refused_settings_end_the_command(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run_up(Settings())  # without a map
    assert ended.value.code == 2
    assert "bridge.map is empty" in capfd.readouterr().err
