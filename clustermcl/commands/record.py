"""`clustermcl record`: write map, scans, odometry and beliefs of a running system to a file."""

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Annotated, TypeVar

import typer
import zenoh

from clustermcl.commands.options import argument, client_command
from clustermcl.link.node import Node
from clustermcl.link.wire import ask
from clustermcl.protocol import keys
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.causes import Named
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import MapMessage, OdometryReading, Scan, ScanHistory
from clustermcl.recordings.maps.map_message import from_message
from clustermcl.recordings.run_log import CHANGES, RunLog
from clustermcl.runtime.output_files import check_output_file
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag, stop_on_signals

M = TypeVar("M", bound=Message)

_POLL_S = 0.1
_MAP_TIMEOUT_S = 30.0
_HISTORY_TIMEOUT_S = 2.0
_END_WITHIN_S = 60.0
"""Limit for writing what was received until Ctrl-C [s]."""

_log = logging.getLogger(__name__)


@client_command
def record(
    settings: Settings,
    file: Annotated[Path, argument("FILE.mcap", "An existing file is replaced.")],
) -> None:
    """Record map, scans, odometry and beliefs, until Ctrl-C."""
    check_output_file(file)
    recorder = Recorder(settings, stop_on_signals(exit_after_s=_END_WITHIN_S))
    recorder.write(file)
    typer.echo(f"{file}: {recorder.steps} steps")


@contextmanager
def recorded(session: zenoh.Session, settings: Settings, path: Path | None) -> Iterator[None]:
    """Record in a thread within the ``with`` block; without a path, record nothing.

    Raises:
        OutputError: the file cannot be written; raised at the end of the block.
    """
    if path is None:
        yield
        return
    stop = StopFlag()
    recorder = Recorder(settings, stop, session)
    with ThreadPoolExecutor(1, "record") as pool:
        writing = pool.submit(recorder.write, path)
        try:
            yield
        finally:
            stop.set()
    writing.result()


class Recorder:
    """Writes scans, odometry, beliefs and the map to a file, until the stop flag is set."""

    def __init__(
        self, settings: Settings, stop: StopFlag, session: zenoh.Session | None = None
    ) -> None:
        self._log: RunLog
        """Opened by `write`."""
        self._last: Scan | None = None
        self.steps = 0
        self._node = Node("record", "recorder", settings, stop, peers=None, session=session)
        self._listen(keys.SCAN, Scan, self._on_scan, 1024)
        self._listen(keys.ODOMETRY, OdometryReading, lambda o: self._log.on_odometry(o), 4096)  # noqa: PLW0108
        self._listen(keys.BELIEF, Belief, lambda b: self._log.on_belief(b, b.stamp_ns), 1024)
        self._listen(keys.CHANGES, Changes, lambda c: self._log.write(CHANGES, c, c.stamp_ns), 16)
        self._node.open(settings.zenoh.connect_timeout_s)

    def write(self, path: Path) -> None:
        with closing(self._node) as node, RunLog(path) as self._log:
            while node.turn(0.0 if node.stop.is_set() else _POLL_S) or not node.stop.is_set():
                pass

    def _listen(
        self, key: str, message: type[M], handler: Callable[[M], object], kept: int
    ) -> None:
        self._node.subscribe(key, message, lambda one, _received: handler(one), kind=key, kept=kept)

    def _on_scan(self, scan: Scan) -> None:
        last = self._last
        if last and scan.step <= last.step and scan.stamp_ns <= last.stamp_ns:
            return  # the scan was published again
        for one in (*self._lost_before(scan), scan):
            if self._log.wants_map(one):
                self._write_map(one)
            self._log.on_scan(one, one.stamp_ns)
            self.steps += 1
        self._last = scan

    def _lost_before(self, scan: Scan) -> tuple[Scan, ...]:
        """Return the scans that were lost before a scan, as far as the bridge still has them."""
        if self._last is None or scan.step <= self._last.step + 1:
            return ()
        selector = keys.scan_history(self._last.step + 1, scan.step - 1)
        try:
            session = self._node.session
            return ask(session, selector, ScanHistory, timeout_s=_HISTORY_TIMEOUT_S).scans
        except ClusterMclError as error:
            self._node.warn(_log, Named("steps lost"), error)
            return ()

    def _write_map(self, scan: Scan) -> None:
        try:
            message = ask(self._node.session, keys.MAP, MapMessage, timeout_s=_MAP_TIMEOUT_S)
            self._log.on_map(from_message(message), scan.stamp_ns)
        except ClusterMclError as error:
            self._node.warn(_log, Named("no map"), error)
