import os
import signal
from functools import partial

import pytest

from clustermcl.commands import up
from clustermcl.commands.stack import ProcessEndedError

run = partial(up.up, robot=None, router=None)


def test_a_killed_check_of_the_settings_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(up, "_check", lambda _: os.kill(os.getpid(), signal.SIGKILL))
    with pytest.raises(ProcessEndedError, match="settings check process ended with SIGKILL"):
        run()


def test_refused_settings_end_the_command(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        run()  # without a map
    assert ended.value.code == 2
    assert "bridge.map is empty" in capfd.readouterr().err
