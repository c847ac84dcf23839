"""A link that was restored and carries nothing: Zenoh did not repeat its declarations.

Here processes reconnect to an empty router while the others are at another one.
"""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
import zenoh

from coordinator.loop import Loop
from coordinator.replica import Replica
from process_runtime.settings import RobotSettings, Settings, ZenohSettings
from process_runtime.stop import StopFlag
from process_runtime.supervisor import python_module
from protocol import keys
from tests.integration.conftest import StartProcess
from tests.integration.processes import RunningProcess
from tests.integration.routers import open_router
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.integration.worlds import write_room
from tests.unit.recordings.logs import ORIGIN, laser_reading
from zenoh_link.node import Node
from zenoh_link.session import open_session
from zenoh_link.stale_session import STALE
from zenoh_link.wire import is_alive

LOOK_S = 2.0


class Detour:
    """A relay in place of the router; it can lead new links to another router."""

    def __init__(self, folder: Path, start_process: StartProcess) -> None:
        self._folder, self._start_process = folder, start_process
        self.settings = ZenohSettings(router=f"unixsock-stream/{folder}/far.sock")
        self._process: RunningProcess | None = None

    def leads_to(self, router: str) -> None:
        """Lead later links to this router; open links stay where they are."""
        link, made = self._folder / "to.sock", self._folder / "made"
        made.symlink_to(self._folder / f"{router}.sock")
        made.replace(link)

    def start(self) -> None:
        """Break all open links, and relay new ones."""
        if self._process is not None:
            self._process.kill()
        far, control = self._folder / "far.sock", self._folder / "control.sock"
        for socket in (far, control):
            socket.unlink(missing_ok=True)
        arguments = ("--listen", far, "--router", self._folder / "to.sock", "--control", control)
        self._process = self._start_process(
            python_module("tests.soak.cables", *(str(argument) for argument in arguments))
        )


@pytest.fixture
def detour(short_folder: str, start_process: StartProcess) -> Detour:
    made = Detour(Path(short_folder), start_process)
    made.leads_to("here")
    made.start()
    return made


def session_at(short_folder: str, router: str) -> Iterator[zenoh.Session]:
    settings = ZenohSettings(router=f"unixsock-stream/{short_folder}/{router}.sock")
    with (
        open_router(settings),
        open_session(settings, RobotSettings(), StopFlag(), wait_s=PATIENCE_S) as session,
    ):
        yield session


@pytest.fixture
def here(short_folder: str) -> Iterator[zenoh.Session]:
    """A session at the router of all others."""
    yield from session_at(short_folder, "here")


@pytest.fixture
def nowhere(short_folder: str) -> Iterator[zenoh.Session]:
    """A session at the empty router."""
    yield from session_at(short_folder, "nowhere")


def comes_back(
    tokens: list[str],
    detour: Detour,
    here: zenoh.Session,
    nowhere: zenoh.Session,
) -> None:
    """Lead the processes with these tokens astray, and wait until they are back.

    Args:
        tokens: by which is seen where they are.
        detour: on which they are led.
        here: where they were, and come back to.
        nowhere: where they are led.
    """

    def are_at(session: zenoh.Session) -> bool:
        return all(is_alive(session, token, LOOK_S) for token in tokens)

    wait_until(lambda: are_at(here))
    detour.leads_to("nowhere")
    detour.start()
    wait_until(lambda: not any(is_alive(here, token, LOOK_S) for token in tokens))
    wait_until(lambda: are_at(nowhere))
    detour.leads_to("here")
    wait_until(lambda: are_at(here))


@pytest.mark.parametrize(
    ("module", "arguments", "token", "other"),
    [
        ("worker", ("--name", "w", "--count", "1"), "worker/w-0/alive", keys.COORDINATOR_ALIVE),
        ("coordinator", (), keys.COORDINATOR_ALIVE, "worker/other/alive"),
    ],
)
def test_a_process_that_receives_nothing_next_to_others_opens_another_session(
    module: str,
    arguments: tuple[str, ...],
    token: str,
    other: str,
    detour: Detour,
    here: zenoh.Session,
    nowhere: zenoh.Session,
    start_process: StartProcess,
) -> None:
    router = ("--set", f"zenoh.router={detour.settings.router}")
    process = start_process(python_module(module, *arguments, *router))
    wait_until(lambda: is_alive(here, token, LOOK_S))
    with here.liveliness().declare_token(other):
        comes_back([token], detour, here, nowhere)
    assert process.is_running()
    assert STALE in process.err


def test_a_bridge_keeps_its_steps_when_another_session_replaces_its_own(
    detour: Detour,
    here: zenoh.Session,
    nowhere: zenoh.Session,
    start_process: StartProcess,
    tmp_path: Path,
) -> None:
    router = ("--set", f"zenoh.router={detour.settings.router}")
    arguments = ("--source", "zenoh", "--map", str(write_room(tmp_path)))
    bridge = start_process(python_module("sensor_bridge", *arguments, *router))
    wait_until(lambda: is_alive(here, keys.BRIDGE_ALIVE, LOOK_S))
    robot = Robot(here)
    robot.publish(laser_reading(1.0, ORIGIN))
    wait_until(robot.steps)
    before = robot.steps()
    with here.liveliness().declare_token(keys.COORDINATOR_ALIVE):
        comes_back([keys.BRIDGE_ALIVE], detour, here, nowhere)
    assert robot.steps() == before
    assert STALE in bridge.err


@pytest.mark.parametrize("has_leader", [True, False])
def test_a_follower_that_receives_nothing_leads_at_once_only_without_another_leader(
    has_leader: bool,
    start_router: Callable[[], RunningProcess],
    zenoh_settings: ZenohSettings,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    silence_s, looked, over = 2.0, list[float](), list[float]()
    opened = threading.Event()

    def sees_leader(_session: zenoh.Session, key: str, _timeout_s: float) -> bool:
        assert key == keys.COORDINATOR_ALIVE
        looked.append(time.monotonic())
        return has_leader

    monkeypatch.setattr("zenoh_link.node.is_alive", sees_leader)
    router, stop = start_router(), StopFlag()
    node = Node("c", "coordinator", Settings(zenoh=zenoh_settings), stop, peers=None)

    def follow() -> None:
        with closing(node):
            node.open()
            opened.set()
            if Loop(node, Replica(silence_s, time.monotonic_ns())).follow():
                over.append(time.monotonic())

    thread = threading.Thread(target=follow)
    thread.start()
    try:
        assert opened.wait(PATIENCE_S)
        router.send_signal(signal.SIGKILL)
        router.wait()
        start_router()
        wait_until(lambda: over)
    finally:
        stop.set()
        thread.join(10.0)
    assert len(looked) == 1
    assert (over[0] - looked[0] >= silence_s) == has_leader, "else another session is silent, too"
