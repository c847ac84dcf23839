import json
import shutil
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import psutil
import pytest

from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import ChildExit, ChildSpec, Supervisor, python_module
from tests.integration.conftest import StartProcess
from tests.integration.processes import python_script
from tests.integration.waiting import stretched_s, wait_until

PROGRAMS = Path(__file__).parent / "programs"


@pytest.fixture
def supervisor() -> Iterator[Supervisor]:
    """Stopped when the test ends; no child of it hangs."""
    made = Supervisor(hung_after_s=1e6)
    yield made
    made.stop()


def router_command(folder: str) -> list[str]:
    endpoint = f"zenoh.router=unixsock-stream/{folder}/supervised.sock"
    return python_module("clustermcl.link.router", "--set", endpoint)


def poll_until_exit(supervisor: Supervisor) -> ChildExit:
    ended: list[ChildExit] = []

    def has_ended() -> bool:
        ended.extend(supervisor.poll(time.monotonic()))
        return bool(ended)

    wait_until(has_ended)
    return ended[0]


def python(program: str) -> list[str]:
    return [sys.executable, "-I", "-c", program]


def gone(pids: Sequence[int]) -> bool:
    """Whether none runs; an unreaped zombie, as in some containers, does not run."""
    for pid in pids:
        try:
            if psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
                return False
        except psutil.NoSuchProcess:
            continue
    return True


@pytest.mark.parametrize(("program", "code"), [("import os; os.kill(os.getpid(), 9)", -9), ("", 0)])
def test_a_child_that_ends_is_started_again(
    program: str, code: int, supervisor: Supervisor
) -> None:
    supervisor.add(ChildSpec("quick", python(program)))
    first = supervisor.pids()["quick"]
    ended = poll_until_exit(supervisor)
    assert (ended.name, ended.code, ended.restart_in_s) == ("quick", code, 0.1)
    assert supervisor.pids() == {}
    wait_until(lambda: supervisor.poll(time.monotonic()) or supervisor.pids())
    assert supervisor.pids()["quick"] != first


GIVES_SIGNS_AND_STAYS = r"""
import os, signal, socket, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
signs = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
address = "\0" + os.environ["NOTIFY_SOCKET"][1:]
print("stays", flush=True)
while True:
    try:
        signs.sendto(b"WATCHDOG=1", address)
    except OSError:
        pass
    time.sleep(0.01)
"""


def test_signs_of_a_child_that_must_leave_do_not_keep_the_supervisor_busy(
    supervisor: Supervisor,
) -> None:
    waits = 0
    supervisor.add(ChildSpec("stays", python(GIVES_SIGNS_AND_STAYS)))
    assert not supervisor.wait(StopFlag()), "a sign, or a second without one"
    supervisor.remove("stays")
    while supervisor.pids():
        waits += 1
        supervisor.wait(StopFlag())
        supervisor.poll(time.monotonic())
    assert waits < 60, "each waits for 0.05 s, and it is killed after 1.2 s"


def test_a_child_that_refuses_its_settings_stays_down_and_its_message_is_shown(
    tmp_path: Path, supervisor: Supervisor
) -> None:
    command = python_module("clustermcl.link.router", "--set", "seed=none")
    supervisor.add(ChildSpec("router", command, log=tmp_path / "router.log"))
    words = "router: --set: seed = 'none': expected a whole number >= 0"
    assert poll_until_exit(supervisor) == ChildExit("router", 2, None, words)
    assert supervisor.poll(time.monotonic() + 1000.0) == []
    assert supervisor.pids() == {}


def test_stop_ends_all_children_within_two_seconds_even_one_that_ignores_signals(
    tmp_path: Path, short_folder: str, supervisor: Supervisor
) -> None:
    log = tmp_path / "stubborn.log"
    children = [
        ChildSpec("router", router_command(short_folder), log=tmp_path / "router.log"),
        ChildSpec("stubborn", python(GIVES_SIGNS_AND_STAYS), log=log),
    ]
    for child in children:
        supervisor.add(child)
    pids = list(supervisor.pids().values())
    wait_until(lambda: "stays" in log.read_text())
    started_s = time.monotonic()
    supervisor.stop()
    assert time.monotonic() - started_s < stretched_s(2.0)
    assert not any(psutil.pid_exists(pid) for pid in pids)  # reaped: not even zombies
    assert supervisor.poll(time.monotonic() + 1000.0) == []


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_the_compilation_of_kernels_ends_with_its_parent(
    number: int, start_process: StartProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It went on for 20 s, on all cores of a robot that starts again."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    process = start_process(python_module("clustermcl.worker", "--count", "1"))
    found = list[psutil.Process]()

    def compiles() -> bool:
        found[:] = psutil.Process(process.pid).children()
        return bool(found) and found[0].cmdline()[-2:-1] == ["clustermcl.jobs.build_kernels"]

    wait_until(compiles)
    if number == signal.SIGINT:  # a terminal sends it to both
        found[0].send_signal(number)
    process.send_signal(number)
    assert process.wait() == (-signal.SIGKILL if number == signal.SIGKILL else 0), process.err
    wait_until(lambda: gone([found[0].pid]), stretched_s(5.0))


@pytest.mark.parametrize("numbers", [[signal.SIGKILL], [signal.SIGTERM], [signal.SIGINT] * 2])
def test_no_child_or_grandchild_outlives_the_supervisor(
    numbers: list[int], start_process: StartProcess, short_folder: str
) -> None:
    endpoint = f"zenoh.router=unixsock-stream/{short_folder}/supervised.sock"
    forking = python_script(PROGRAMS / "forking.py", "--set", endpoint)
    children = [["router", router_command(short_folder)], ["forking", forking]]
    process = start_process(python_script(PROGRAMS / "supervising.py", json.dumps(children)))
    for index in range(3):
        process.wait_for(f"child {index} is ")
    pids = [child.pid for child in psutil.Process(process.pid).children(recursive=True)]
    assert len(pids) == 5
    started_s = time.monotonic()
    for number in numbers:
        process.send_signal(number)
    assert process.wait() == (-signal.SIGKILL if signal.SIGKILL in numbers else 0)
    assert "Traceback" not in process.err
    wait_until(lambda: gone(pids))
    assert time.monotonic() - started_s < stretched_s(2.0)
