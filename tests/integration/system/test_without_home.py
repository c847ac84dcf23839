"""An account with a number only, as of `docker run --user N`: no name, no home, one folder."""

import os
import pwd
import shutil
import signal
from contextlib import suppress
from pathlib import Path

import pytest

from clustermcl.client import Client
from clustermcl.runtime.settings import Settings, ZenohSettings
from tests.integration.processes import RunningProcess
from tests.integration.system.commands import COMMAND, SMALL_FILTER
from tests.integration.waiting import wait_until

ACCOUNT = 54321
AS_ACCOUNT = [
    *("setpriv", f"--reuid={ACCOUNT}", f"--regid={ACCOUNT}", "--clear-groups"),
    # It may read the interpreter and these sources, wherever they are.
    *("--inh-caps=-all,+dac_read_search", "--ambient-caps=-all,+dac_read_search"),
]


def has_name() -> bool:
    with suppress(KeyError):
        return bool(pwd.getpwuid(ACCOUNT))
    return False


pytestmark = pytest.mark.skipif(
    os.geteuid() != 0 or not shutil.which("setpriv") or has_name(),
    reason="needs root and setpriv, to become an account without a name",
)


@pytest.fixture
def folder(short_folder: str) -> Path:
    """The only folder that the account may write."""
    Path(short_folder).chmod(0o1777)
    return Path(short_folder)


def test_a_system_starts_and_keeps_its_state(
    folder: Path, zenoh_settings: ZenohSettings, tmp_path: Path
) -> None:
    words = ["up", "--set", f"zenoh.router={zenoh_settings.router}", "--set", "worker.count=2"]
    words += ["--set", "bridge.source=sim:cross", "--set", "bridge.rate=4", *SMALL_FILTER]
    command, own = [*AS_ACCOUNT, *COMMAND, *words], folder / f"clustermcl-{ACCOUNT}"
    up = RunningProcess(
        command, tmp_path, "up", env={"PATH": os.environ["PATH"], "TMPDIR": str(folder)}
    )
    try:
        with Client(Settings(zenoh=zenoh_settings)) as client:
            wait_until(lambda: client.pose().probability > 0.0)
        state = own / "state"
        wait_until(lambda: any(state.glob("state-robot.msgpack*")))
        wait_until(lambda: any(state.glob("flight-recorder/robot/*.mcap")))
        up.send_signal(signal.SIGINT)
        assert up.wait() == 0
    finally:
        up.kill()
    assert list(own.glob("maps/field-*"))
    assert own.stat().st_mode & 0o077 == 0
    assert f"maps: kept in {own}/maps until the machine restarts" in up.err
    assert "Traceback" not in up.err
    assert "restarting" not in up.err
