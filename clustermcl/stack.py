"""Starts, supervises and stops all processes of one robot on this machine."""

import fcntl
import logging
import os
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import assert_never

import msgspec

from process_runtime.main import EXIT_ERROR
from process_runtime.settings import Settings
from process_runtime.settings_table import settings_as_toml
from process_runtime.sources import Live, Recorded, Simulated, parsed_source
from process_runtime.supervisor import ChildExit, ChildSpec, Supervisor, python_module
from protocol.errors import ClusterMclError
from zenoh_link.configuration import SOCKET_PATH_MAX_BYTES

ROUTER, WORKERS, COORDINATOR = "router", "worker", "coordinator"
_FOLDER_PREFIX, _LOCK = "clustermcl-", "lock"
_NEWBORN_S = 10.0
"""A younger folder may not have its lock yet [s]."""

_log = logging.getLogger(__name__)


class ProcessEndedError(ClusterMclError):
    """A process of the stack refused to start, or ended although it should not have."""

    def __init__(self, ended: ChildExit) -> None:
        self.ended = ended
        if ended.code == EXIT_ERROR and ended.last_words:
            super().__init__(ended.last_words)
            return
        how = f"exit code {ended.code}"
        if ended.code < 0:
            how = signal.Signals(-ended.code).name
        words = f": {ended.last_words}" if ended.last_words else "; its own message is above"
        super().__init__(f"the {ended.name} process ended with {how}{words}")


class Stack:
    """Router, workers, coordinator, and a sensor bridge or a simulator in its place.

    Args:
        settings: settings of all processes; `bridge.source` selects bridge or simulator,
            `zenoh.start_router` adds a router, `ros2.enabled` a bridge to ROS.
        folder: folder for their settings file and logs.
        logs_in_folder: write logs to the folder instead of standard error.
        simulator_arguments: additional arguments for the simulator.
        page_arguments: arguments for the page; None: no page.
        beside: also localize by AMCL's filter, for the page; see `evaluation.beside`.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        *,
        logs_in_folder: bool,
        simulator_arguments: Sequence[str] = (),
        page_arguments: Sequence[str] | None = None,
        beside: bool = False,
    ) -> None:
        self._folder, self._logs_in_folder = folder, logs_in_folder
        self._file = folder / "settings.toml"
        self._file.write_text(settings_as_toml(settings), encoding="utf-8")
        match parsed_source(settings.bridge.source):
            case Simulated():
                source = self._child("robot_simulator", *simulator_arguments)
            case Live() | Recorded():
                source = self._child("sensor_bridge")
            case choice:
                assert_never(choice)
        others = []
        if settings.zenoh.start_router:
            others.append(self._child("zenoh_link.router", name=ROUTER))
        if page_arguments is not None:
            others.append(self._child("live_view", *page_arguments))
        if beside:
            others.append(self._child("evaluation.beside", name="amcl"))
        if settings.ros2.enabled:
            others.append(self._child("ros2_bridge"))
        self._coordinator = self._child("coordinator")
        self._supervisor = Supervisor([*others, self._child("worker"), source])

    def start_all(self) -> None:
        self.start_without_coordinator()
        self.start_coordinator()

    def start_without_coordinator(self) -> None:
        """Start all processes but the coordinator, for which the source waits."""
        self._supervisor.start()

    def start_coordinator(self) -> None:
        """Start the coordinator, after which the source sends its first step."""
        self._supervisor.add(self._coordinator)

    def ended(self) -> list[ChildExit]:
        """Restart processes that are due, and return those that ended since the last call."""
        return self._supervisor.poll(time.monotonic())

    def pids(self) -> dict[str, int]:
        """Return the process ids by name; all workers are one entry, their parent process."""
        return self._supervisor.pids()

    def check(self) -> None:
        """Supervise the processes.

        Raises:
            ProcessEndedError: a process has ended; the error has its last log lines.
        """
        for ended in self.ended():
            raise ProcessEndedError(ended)

    def stop(self) -> None:
        self._supervisor.stop()

    def _child(self, module: str, *arguments: str, name: str | None = None) -> ChildSpec:
        name = name or module
        return ChildSpec(
            name=name,
            command=python_module(module, "--settings", str(self._file), *arguments),
            log=self._folder / f"{name}.log" if self._logs_in_folder else None,
        )


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Create a folder for sockets and logs, which is removed at the end.

    After a SIGKILL the folder remains without a lock, and the next process removes it.
    """
    # The path of the router's socket is the longest, and limited by the operating system.
    base = Path(tempfile.gettempdir())
    room = SOCKET_PATH_MAX_BYTES - len("/clustermcl-12345678/router.sock")
    folder = base if len(os.fsencode(base)) <= room else Path("/tmp")
    _remove_orphans(folder)
    with (
        tempfile.TemporaryDirectory(prefix=_FOLDER_PREFIX, dir=folder) as path,
        (Path(path) / _LOCK).open("w") as lock,
    ):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield Path(path)


def _remove_orphans(base: Path) -> None:
    """Remove the folders of killed processes, whose locks the kernel has released."""
    for folder in base.glob(f"{_FOLDER_PREFIX}*"):
        try:
            about = folder.lstat()
            if about.st_uid != os.getuid() or time.time() - about.st_mtime < _NEWBORN_S:
                continue
            with (folder / _LOCK).open() as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)
        except OSError:  # in use, not our folder, or just being removed by another process
            continue


def meeting_in(folder: Path, settings: Settings) -> Settings:
    """Return settings with the router at a Unix socket in a folder, private to its user.

    The coordinator keeps its state there too, unless the settings name another folder, so that
    nothing remains for the next run.
    """
    router = f"unixsock-stream/{folder}/router.sock"
    zenoh = msgspec.structs.replace(settings.zenoh, router=router, start_router=True)
    coordinator = settings.coordinator
    if not coordinator.state_folder:
        coordinator = msgspec.structs.replace(coordinator, state_folder=str(folder / "state"))
    return msgspec.structs.replace(settings, zenoh=zenoh, coordinator=coordinator)


@contextmanager
def running(stack: Stack) -> Iterator[Stack]:
    """Stop the stack at the end of the ``with`` block."""
    try:
        yield stack
    finally:
        stack.stop()
