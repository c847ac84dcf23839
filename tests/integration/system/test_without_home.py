"""An account with a number only, as of `docker run --user N`: no name, no home, one folder."""

import os
import pwd
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

from clustermcl.client import Client
from clustermcl.runtime.settings import Settings, ZenohSettings
from tests.integration.processes import RunningProcess
from tests.integration.system.commands import COMMAND, SMALL_FILTER
from tests.integration.waiting import PATIENCE_S, wait_until

ACCOUNT = 54321
AS_ACCOUNT = [
    *("setpriv", f"--reuid={ACCOUNT}", f"--regid={ACCOUNT}", "--clear-groups"),
    # It may read the interpreter and these sources, wherever they are.
    *("--inh-caps=-all,+dac_read_search", "--ambient-caps=-all,+dac_read_search"),
]
LIBRARY = """
from clustermcl import ClusterMCL, Reading
from clustermcl.simulator.worlds.catalogue import world
small = {"search.poses": 200, "search.heading_step_rad": 0.2, "search.shards": 1}
mcl = ClusterMCL(world("cross_feature").map, settings=small)
print(mcl.update(Reading((0.0, 0.0, 0.0), [1.0] * 20, angle_step=0.3, range_max=9.0)).step)
"""


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


def environment(folder: Path) -> dict[str, str]:
    return {"PATH": os.environ["PATH"], "TMPDIR": str(folder)}


def test_the_library_localizes(folder: Path) -> None:
    ran = subprocess.run(
        [*AS_ACCOUNT, sys.executable, "-I", "-c", LIBRARY],
        env=environment(folder) | {"HOME": "/"}, capture_output=True, text=True, check=False,
        timeout=PATIENCE_S,
    )  # fmt: skip
    assert (ran.returncode, ran.stdout) == (0, "0\n"), ran.stderr
    own = folder / f"clustermcl-{ACCOUNT}"
    assert list(own.glob("maps/field-*"))
    assert own.stat().st_mode & 0o077 == 0
    assert f"maps: kept in {own}/maps until the machine restarts" in ran.stderr


def test_a_system_starts_and_keeps_its_state(
    folder: Path, zenoh_settings: ZenohSettings, tmp_path: Path
) -> None:
    words = ["up", "--set", f"zenoh.router={zenoh_settings.router}", "--set", "worker.count=2"]
    words += ["--set", "bridge.source=sim:cross", "--set", "bridge.rate=4", *SMALL_FILTER]
    command = [*AS_ACCOUNT, *COMMAND, *words]
    up = RunningProcess(command, tmp_path, "up", env=environment(folder))
    try:
        with Client(Settings(zenoh=zenoh_settings)) as client:
            wait_until(lambda: client.pose().probability > 0.0)
        state = folder / f"clustermcl-{ACCOUNT}" / "state"
        wait_until(lambda: any(state.glob("state-robot.msgpack*")))
        wait_until(lambda: any(state.glob("flight-recorder/robot/*.mcap")))
        up.send_signal(signal.SIGINT)
        assert up.wait() == 0
    finally:
        up.kill()
    assert "Traceback" not in up.err
    assert "restarting" not in up.err
