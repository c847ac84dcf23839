import os
import shlex
import shutil
import signal
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import psutil
import pytest

from clustermcl.client import Client
from clustermcl.coordinator.recorder.ring import files_in, series_of
from clustermcl.protocol.errors import UnreachableError
from clustermcl.runtime.settings import Settings, ZenohSettings
from tests.integration.processes import RunningProcess
from tests.integration.system.commands import COMMAND, SMALL_FILTER, TypedCommand, ran, typed
from tests.integration.waiting import wait_until
from tests.integration.worlds import write_room
from tests.unit.test_imports import COMPILERS


@pytest.fixture
def settings(zenoh_settings: ZenohSettings) -> Settings:
    patient = msgspec.structs.replace(zenoh_settings, connect_timeout_s=30.0)
    return Settings(zenoh=patient)


@pytest.fixture
def words(settings: Settings) -> list[str]:
    return [
        "up", "--set", f"zenoh.router={settings.zenoh.router}", "--set", "worker.count=2",
        "--set", "bridge.source=sim:cross", "--set", "bridge.rate=4", *SMALL_FILTER,
    ]  # fmt: skip


@pytest.fixture
def up(words: list[str], environment: dict[str, str], tmp_path: Path) -> Iterator[TypedCommand]:
    with typed(*words, folder=tmp_path, environment=environment) as command:
        yield command


def pid_of(up: TypedCommand, module: str) -> int:
    """The process id of a child; 0 while there is none."""
    command = f"clustermcl.{module}"
    found = [process.pid for process in up.meet_family() if command in process.cmdline()]
    return found[0] if found else 0


def kill_and_wait_for_the_next(up: TypedCommand, module: str) -> None:
    killed = pid_of(up, module)
    os.kill(killed, signal.SIGKILL)
    wait_until(lambda: f"{module} ended with code -9" in up.err)
    wait_until(lambda: pid_of(up, module) not in (0, killed))


def heavy_libraries(pid: int) -> set[str]:
    files = {Path(mapped.path).parts for mapped in psutil.Process(pid).memory_maps()}
    return {name for name in COMPILERS if any(name in parts for parts in files)}


def test_killed_processes_are_restarted_and_ctrl_c_ends_everything(
    up: TypedCommand, settings: Settings, tmp_path: Path
) -> None:
    recording = tmp_path / "clustermcl" / "flight-recorder" / "robot"
    with Client(settings) as client:
        wait_until(lambda: client.pose().probability > 0.0)
        wait_until(lambda: any(recording.glob("*.mcap")))  # a thread of the coordinator writes it
        loaded = {
            module: heavy_libraries(pid_of(up, module))
            for module in ("coordinator", "link.router", "worker", "simulator")
        }
        for module in ("coordinator", "worker", "simulator"):
            kill_and_wait_for_the_next(up, module)
        step = client.pose().step
        wait_until(lambda: client.pose().step > step)
        wait_until(lambda: len(client.status().workers) == 2)
    assert up.end(signal.SIGINT) == 0
    assert "Traceback" not in up.err
    up.assert_nothing_runs()
    series = {series_of(file) for file in files_in(recording)}
    assert len(series) == 2, "of both coordinators, without being asked"
    assert "scipy" in loaded.pop("simulator")
    assert not loaded.pop("worker") & {"numba", "llvmlite"}, "it has the library of kernels"
    assert loaded == {"coordinator": set(), "link.router": set()}, "no mathematics"


def test_a_killed_system_leaves_no_process_and_the_next_one_removes_its_folder(
    up: TypedCommand,
    words: list[str],
    settings: Settings,
    environment: dict[str, str],
    tmp_path: Path,
) -> None:
    """The next one has no standard error: it ended with 1, without a word."""
    up.wait_for("router listens")
    temporary = Path(environment["TMPDIR"])
    (left,) = temporary.glob("clustermcl-*")
    up.meet_family()
    os.kill(up.pid, signal.SIGKILL)
    up.assert_nothing_runs()
    assert left.exists()
    command = ["sh", "-c", f"exec {shlex.join([*COMMAND, *words])} 2>&-"]
    following = RunningProcess(command, tmp_path, "following", env=environment)
    try:
        with Client(settings) as client:
            wait_until(lambda: client.pose().probability > 0.0)
        assert not left.exists()
        following.send_signal(signal.SIGINT)
        assert following.wait() == 0
    finally:
        following.kill()
    assert list(temporary.glob("clustermcl-*")) == []


def test_a_second_robot_shares_the_router_and_is_found_by_its_name(
    up: TypedCommand,
    words: list[str],
    settings: Settings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    environment: dict[str, str],
) -> None:
    up.wait_for("router listens")
    refused = ran(*words)
    assert refused.returncode == 2
    assert "is in use" in refused.stderr
    assert "clustermcl up --robot NAME --set zenoh.start_router=false" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert up.is_running(), "the first goes on"
    with (
        Client(settings, robot="nobody", timeout_s=0.5) as client,
        pytest.raises(UnreachableError, match="no coordinator of robot 'nobody' answers"),
    ):
        client.beliefs()
    folder, router = tmp_path / "second", settings.zenoh.router
    folder.mkdir()
    own = ["--robot", "r1", "--set", "zenoh.start_router=false", "--set", "bridge.source=sim:hall"]
    with typed(*words, *own, folder=folder, environment=environment) as second:
        second.wait_for(f"query it with: clustermcl pose --robot r1 --router {router}")
        second.wait_for("see what happened with: clustermcl replay ")
        monkeypatch.setenv("CLUSTERMCL_ROBOT", "r1")
        monkeypatch.setenv("CLUSTERMCL_ROUTER", router)
        with Client(timeout_s=60.0) as named:
            assert next(named.beliefs(timeout_s=60.0)).step >= 0
            found = named.wait_until_localized(60.0)
            assert (found.state, found.freshness) == ("localized", "fresh")
            assert found.pose is not None
        assert second.end(signal.SIGINT) == 0
        second.assert_nothing_runs()


COMPILING_S = 250.0
"""Time-out of compiling all kernels, 20 s on an idle machine [s]."""


@pytest.mark.skipif(not shutil.which(os.environ.get("CC", "cc")), reason="no C compiler")
def test_two_first_starts_at_once_build_one_library_of_kernels_and_prepare_the_map(
    tmp_path: Path, environment: dict[str, str]
) -> None:
    environment = {**environment, "NUMBA_CACHE_DIR": str(tmp_path / "kernels")}
    map_file = write_room(tmp_path, cells=(20, 20))

    def warm_up(_: int) -> subprocess.CompletedProcess[str]:
        words = ("warm-up", "--set", f"bridge.map={map_file}")
        return ran(*words, environment=environment, timeout_s=COMPILING_S)

    with ThreadPoolExecutor() as pool:
        starts = list(pool.map(warm_up, range(2)))
    assert [(start.returncode, start.stdout) for start in starts] == [(0, "")] * 2
    assert len(list((tmp_path / "kernels").glob("kernels-*.so"))) == 1
    assert list((tmp_path / "clustermcl" / "maps").glob("field-*"))
