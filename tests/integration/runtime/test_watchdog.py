import os
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from clustermcl.runtime.main import EXIT_ERROR
from clustermcl.runtime.supervisor import python_module
from clustermcl.runtime.watchdog import SignsOfLife
from tests.integration.conftest import StartProcess
from tests.integration.processes import python_script
from tests.integration.waiting import PATIENCE_S

HANGING = Path(__file__).parent / "programs" / "hanging.py"
NOWHERE = ("--set", "zenoh.router=tcp/127.0.0.1:9")


class Systemd(socket.socket):
    """The other end of NOTIFY_SOCKET."""

    def receives(self, within_s: float) -> bytes | None:
        self.settimeout(within_s)
        try:
            return self.recv(100)
        except TimeoutError:
            return None

    def receives_no_more(self) -> bool:
        """Whether there is a silence of more than WATCHDOG_USEC in the next seconds."""
        until_s = time.monotonic() + 10.0
        while self.receives(0.6) is not None:
            if time.monotonic() > until_s:
                return False
        return True


@pytest.fixture
def systemd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Systemd]:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    monkeypatch.setenv("WATCHDOG_USEC", "400000")
    with Systemd(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        yield listening


@pytest.mark.parametrize(
    "command",
    [
        python_module("clustermcl.link.router", "--set", "zenoh.router=unixsock-stream/{folder}/r"),
        python_module("clustermcl.worker", "--count", "1", *NOWHERE),
    ],
    ids=["router", "worker"],
)
def test_a_process_reports_that_it_is_ready_and_runs_until_it_is_stopped(
    systemd: Systemd, start_process: StartProcess, command: list[str], tmp_path: Path
) -> None:
    process = start_process([word.replace("{folder}", str(tmp_path)) for word in command])
    assert systemd.receives(PATIENCE_S) == b"READY=1\nWATCHDOG=1"
    for _ in range(6):
        assert systemd.receives(PATIENCE_S) == b"WATCHDOG=1"
    process.send_signal(signal.SIGSTOP)
    assert systemd.receives_no_more()
    process.send_signal(signal.SIGCONT)
    assert systemd.receives(PATIENCE_S) == b"WATCHDOG=1"


def test_a_process_that_fails_at_its_start_never_reports_that_it_is_ready(
    systemd: Systemd, start_process: StartProcess
) -> None:
    process = start_process(python_module("clustermcl.sensor_bridge", "--set", "bridge.map="))
    assert process.wait() == EXIT_ERROR
    assert systemd.receives(0.1) is None


def test_a_hanging_loop_sends_no_sign_of_life_although_a_thread_runs(
    systemd: Systemd, start_process: StartProcess
) -> None:
    process = start_process(python_script(HANGING))
    process.wait_for("goes round")
    assert systemd.receives(PATIENCE_S) == b"READY=1\nWATCHDOG=1"
    process.send_signal(signal.SIGUSR1)
    process.wait_for("hangs")
    assert systemd.receives_no_more()
    process.send_signal(signal.SIGABRT)  # as systemd does then
    assert process.wait() == -signal.SIGABRT
    assert "never.wait()" in process.err or "in body" in process.err


def test_only_the_named_process_gives_signs_and_no_watchdog_delays_it(
    systemd: Systemd, tmp_path: Path
) -> None:
    SignsOfLife({}).give()
    named = {"NOTIFY_SOCKET": os.environ["NOTIFY_SOCKET"], "WATCHDOG_USEC": "1"}
    SignsOfLife({**named, "WATCHDOG_PID": "1"}).give()
    assert systemd.receives(0.1) is None
    own = SignsOfLife({**named, "WATCHDOG_PID": str(os.getpid())})
    for _ in range(2000):  # more than the socket holds
        own.give()
    assert systemd.receives(PATIENCE_S) == b"READY=1\nWATCHDOG=1"
    SignsOfLife({"NOTIFY_SOCKET": str(tmp_path / "gone"), "WATCHDOG_USEC": "1"}).give()
