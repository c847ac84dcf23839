"""Fixtures of real Zenoh sessions over a Unix socket in a folder of each test."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from clustermcl.link.session import open_session
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from tests.integration.processes import RunningProcess
from tests.integration.routers import open_router
from tests.integration.waiting import PATIENCE_S, patient

StartProcess = Callable[[Sequence[str]], RunningProcess]
OpenClient = Callable[[], zenoh.Session]


@pytest.fixture(autouse=True, scope="session")
def state_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Processes keep their last poses with the tests, not with the user who runs them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


@pytest.fixture
def environment(short_folder: str, tmp_path: Path) -> dict[str, str]:
    """Commands write into folders of this test; that of temporary files fits a socket's path."""
    kept = str(tmp_path)
    own = {"TMPDIR": short_folder, "XDG_CACHE_HOME": kept, "XDG_STATE_HOME": kept}
    return {**os.environ, **own}


@pytest.fixture
def zenoh_settings(short_folder: str) -> ZenohSettings:
    """Settings whose router listens on a socket of this test; nothing listens there yet."""
    return patient(ZenohSettings(router=f"unixsock-stream/{short_folder}/router.sock"))


@pytest.fixture
def router(zenoh_settings: ZenohSettings) -> Iterator[ZenohSettings]:
    """A router in this process, listening; the settings to reach it with."""
    with open_router(zenoh_settings):
        yield zenoh_settings


@pytest.fixture
def open_client(zenoh_settings: ZenohSettings) -> Iterator[OpenClient]:
    """Opens sessions of the robot ``robot``; they are closed when the test ends."""
    with ExitStack() as sessions:
        yield lambda: sessions.enter_context(
            open_session(zenoh_settings, RobotSettings(), StopFlag(), wait_s=PATIENCE_S)
        )


@pytest.fixture
def start_process(tmp_path: Path) -> Iterator[StartProcess]:
    """Starts processes; those still running when the test ends are killed."""
    started: list[RunningProcess] = []

    def start(command: Sequence[str]) -> RunningProcess:
        process = RunningProcess(command, tmp_path, f"process-{len(started)}")
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()


@pytest.fixture
def start_router(
    zenoh_settings: ZenohSettings, start_process: StartProcess
) -> Callable[[], RunningProcess]:
    """Starts a router in a process of its own, which can be killed; returns once it listens."""

    def start() -> RunningProcess:
        endpoint = f"zenoh.router={zenoh_settings.router}"
        process = start_process(python_module("clustermcl.link.router", "--set", endpoint))
        process.wait_for("router listens at")
        return process

    return start
