"""Starts, supervises and stops all processes of one robot on this machine."""

import os
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import msgspec

from clustermcl.protocol.errors import ClusterMclError
from clustermcl.runtime.folders import claimed
from clustermcl.runtime.main import EXIT_ERROR
from clustermcl.runtime.settings import SOCKET_PATH_MAX_BYTES, Settings
from clustermcl.runtime.settings_table import settings_as_toml
from clustermcl.runtime.sources import Simulated, parsed_source
from clustermcl.runtime.supervisor import ChildExit, ChildSpec, Supervisor, python_module

ROUTER, WORKERS, COORDINATOR = "router", "worker", "coordinator"
_PREFIX, _MARK = "clustermcl-", "claimed"


class ProcessEndedError(ClusterMclError):
    """A process of the stack refused to start, or ended unexpectedly; `ended` has its exit."""

    def __init__(self, ended: ChildExit) -> None:
        self.ended = ended
        if ended.code == EXIT_ERROR and ended.last_words:
            super().__init__(ended.last_words)
            return
        how = signal.Signals(-ended.code).name if ended.code < 0 else f"exit code {ended.code}"
        words = f": {ended.last_words}" if ended.last_words else "; its own message is above"
        super().__init__(f"the {ended.name} process ended with {how}{words}")


class Stack:
    """The processes of one robot: coordinator, workers, a sensor bridge or simulator, and others.

    `bridge.source` selects bridge or simulator, `zenoh.start_router` adds a router; page
    arguments add a page. The folder is for the processes' settings file, and for their logs,
    unless these go to standard error.
    """

    def __init__(
        self,
        settings: Settings,
        folder: Path,
        *,
        logs_in_folder: bool,
        simulator_arguments: Sequence[str] = (),
        page_arguments: Sequence[str] | None = None,
    ) -> None:
        self._folder, self._logs_in_folder = folder, logs_in_folder
        self._file = folder / "settings.toml"
        self._file.write_text(settings_as_toml(settings), encoding="utf-8")
        source = self._child("sensor_bridge")
        if isinstance(parsed_source(settings.bridge.source), Simulated):
            source = self._child("simulator", *simulator_arguments)
        others = []
        if settings.zenoh.start_router:
            others.append(self._child("link.router", name=ROUTER))
        if page_arguments is not None:
            others.append(self._child("view", *page_arguments))
        self._coordinator = self._child("coordinator")
        self._others = [*others, self._child("worker"), source]
        self.supervisor = Supervisor()

    def start_all(self) -> None:
        self.start_without_coordinator()
        self.start_coordinator()

    def start_without_coordinator(self) -> None:
        """Start all processes but the coordinator; without it, the source makes no step."""
        for child in self._others:
            self.supervisor.add(child)

    def start_coordinator(self) -> None:
        self.supervisor.add(self._coordinator)

    def check(self) -> None:
        """Raise a `ProcessEndedError`, with the last log lines, if a process has ended."""
        for ended in self.supervisor.poll(time.monotonic()):
            raise ProcessEndedError(ended)

    def close(self) -> None:
        self.supervisor.stop()

    def _child(self, module: str, *arguments: str, name: str | None = None) -> ChildSpec:
        name = name or module
        return ChildSpec(
            name=name,
            command=python_module(
                f"clustermcl.{module}", "--settings", str(self._file), *arguments
            ),
            log=self._folder / f"{name}.log" if self._logs_in_folder else None,
        )


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Create a folder for sockets and logs, which is removed at the end of the ``with`` block.

    Folders that killed processes of this account left are removed too. It is claimed, so
    systemd-tmpfiles does not remove its files, which a process restarted after weeks still needs.
    """
    # The operating system limits the length of a socket's path; the router's is the longest.
    base = Path(tempfile.gettempdir())
    room = SOCKET_PATH_MAX_BYTES - len("/clustermcl-12345678/router.sock")
    folder = base if len(os.fsencode(base)) <= room else Path("/tmp")
    with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=folder) as name:
        path = Path(name)
        with claimed(path):
            (path / _MARK).touch()  # others see it only once it is claimed
            _remove_left(folder)
            yield path


def _remove_left(folder: Path) -> None:
    for path in (mark.parent for mark in folder.glob(f"{_PREFIX}*/{_MARK}")):
        with suppress(OSError):  # it is being removed
            if path.lstat().st_uid != os.getuid():
                continue
            with claimed(path) as is_left:
                if is_left:
                    shutil.rmtree(path)


def meeting_in(folder: Path, settings: Settings) -> Settings:
    """Return settings of a system whose router listens at a Unix socket in a folder.

    The coordinator writes its state to this folder, unless the settings name another one.
    """
    router = f"unixsock-stream/{folder}/router.sock"
    zenoh = msgspec.structs.replace(settings.zenoh, router=router, start_router=True)
    coordinator = settings.coordinator
    if not coordinator.state_folder:
        coordinator = msgspec.structs.replace(coordinator, state_folder=str(folder / "state"))
    return msgspec.structs.replace(settings, zenoh=zenoh, coordinator=coordinator)
