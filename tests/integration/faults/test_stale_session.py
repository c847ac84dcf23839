"""A link that was restored and carries nothing: Zenoh did not repeat its declarations.

Here processes reconnect to an empty router while the others are at another one.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import pytest
import zenoh

from clustermcl.coordinator.loop import Loop
from clustermcl.coordinator.replica import Replica
from clustermcl.link.node import Node
from clustermcl.link.session import open_session
from clustermcl.link.stale_session import STALE
from clustermcl.link.wire import is_alive
from clustermcl.protocol import keys
from clustermcl.runtime.settings import RobotSettings, Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from tests.integration.conftest import StartProcess
from tests.integration.processes import RunningProcess, python_script
from tests.integration.routers import open_router
from tests.integration.running import running
from tests.integration.sensor_bridge.robot import Robot
from tests.integration.waiting import PATIENCE_S, wait_until
from tests.integration.worlds import write_room
from tests.unit.recordings.logs import ORIGIN, laser_reading

LOOK_S = 2.0
RELAY = Path(__file__).parent / "programs" / "relay.py"


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
        far = self._folder / "far.sock"
        far.unlink(missing_ok=True)
        words = ("--listen", str(far), "--router", str(self._folder / "to.sock"))
        self._process = self._start_process(python_script(RELAY, *words))


TOKENS = {
    "worker": ("worker/w-0/alive", keys.COORDINATOR_ALIVE),
    "coordinator": (keys.COORDINATOR_ALIVE, "worker/other/alive"),
    "sensor_bridge": (keys.BRIDGE_ALIVE, keys.COORDINATOR_ALIVE),
}
"""Each process, its own token, and that of another process of its robot."""


@contextmanager
def sessions_at(folder: str, router: str) -> Iterator[dict[str, zenoh.Session]]:
    """Start a router; yield a session of each process's robot, which is named like the process."""
    settings = ZenohSettings(router=f"unixsock-stream/{folder}/{router}.sock")
    with open_router(settings), ExitStack() as opened:
        yield {
            name: opened.enter_context(
                open_session(settings, RobotSettings(name=name), StopFlag(), wait_s=PATIENCE_S)
            )
            for name in TOKENS
        }


def are_at(sessions: dict[str, zenoh.Session]) -> list[bool]:
    return [is_alive(sessions[name], own, LOOK_S) for name, (own, _) in TOKENS.items()]


def test_processes_that_receive_nothing_next_to_others_open_other_sessions_and_keep_their_state(
    short_folder: str, start_process: StartProcess, tmp_path: Path
) -> None:
    detour = Detour(Path(short_folder), start_process)
    detour.leads_to("here")
    detour.start()
    room = write_room(tmp_path)
    arguments = {
        "worker": ("--name", "w", "--count", "1"),
        "coordinator": (),
        "sensor_bridge": ("--set", "bridge.source=zenoh", "--set", f"bridge.map={room}"),
    }
    processes = []
    for name, words in arguments.items():
        settings = (f"zenoh.router={detour.settings.router}", f"robot.name={name}")
        given = [word for setting in settings for word in ("--set", setting)]
        processes.append(start_process(python_module(name, *words, *given)))
    with sessions_at(short_folder, "here") as here, sessions_at(short_folder, "nowhere") as nowhere:
        wait_until(lambda: all(are_at(here)))
        robot = Robot(here["sensor_bridge"])
        robot.publish(laser_reading(1.0, ORIGIN))
        wait_until(robot.steps)
        before = robot.steps()
        with ExitStack() as declared:
            for name, (_, other) in TOKENS.items():
                declared.enter_context(here[name].liveliness().declare_token(other))
            detour.leads_to("nowhere")
            detour.start()
            wait_until(lambda: not any(are_at(here)))
            wait_until(lambda: all(are_at(nowhere)))
            detour.leads_to("here")
            wait_until(lambda: all(are_at(here)))
        assert robot.steps() == before
    for process in processes:
        assert process.is_running()
        assert STALE in process.err


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

    monkeypatch.setattr("clustermcl.link.wire.is_alive", sees_leader)
    router, settings = start_router(), Settings(zenoh=zenoh_settings)

    def follow(stop: StopFlag) -> None:
        with closing(Node("c", "coordinator", settings, stop, peers=None)) as node:
            node.open()
            opened.set()
            if Loop(node, Replica(silence_s, time.monotonic_ns()), 0.0).follow():
                over.append(time.monotonic())

    with running(follow):
        assert opened.wait(PATIENCE_S)
        router.kill()
        start_router()
        wait_until(lambda: over)
    assert len(looked) == 1
    assert (over[0] - looked[0] >= silence_s) == has_leader, "else another session is silent, too"
