"""`clustermcl record`: write map, scans, odometry and beliefs of a running system to a file."""

import logging
import signal
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import zenoh

from grid_maps.map_message import from_message
from process_runtime.logs import CauseCounter
from process_runtime.settings import Settings
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Belief
from protocol.codec import decode
from protocol.errors import ClusterMclError, MalformedMessageError
from protocol.steps import MapMessage, OdometryReading, Scan, ScanHistory
from recordings.run_log import RunLog
from zenoh_link.inbox import Inbox
from zenoh_link.session import open_session
from zenoh_link.wire import Events, Received, ask, subscribe

_POLL_S = 0.1
_MAP_TIMEOUT_S = 30.0
_HISTORY_TIMEOUT_S = 2.0
_KEPT = {"scan": 1024, "odometry": 4096, "belief": 1024}

_log = logging.getLogger(__name__)


def run_record(settings: Settings, path: Path) -> int:
    """Record until SIGINT or SIGTERM, and return the number of recorded steps."""
    stop = StopFlag()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    within_s = settings.zenoh.connect_timeout_s
    with open_session(settings.zenoh, settings.robot, stop, wait_s=within_s) as session:
        listener = Listener(session)
        listener.write(path, stop)
        return listener.steps


@contextmanager
def recorded(session: zenoh.Session, path: Path | None) -> Iterator[None]:
    """Record in a thread within the ``with`` block; without a path, record nothing.

    Raises:
        OutputError: the file cannot be written; raised at the end of the block.
    """
    if path is None:
        yield
        return
    stop, listener = StopFlag(), Listener(session)
    with ThreadPoolExecutor(1, "record") as pool:
        writing = pool.submit(listener.write, path, stop)
        try:
            yield
        finally:
            stop.set()
    writing.result()


def received_until(stop: StopFlag, inbox: Events) -> Iterator[Received]:
    """Yield received messages until the flag is set and the inbox is empty."""
    while True:
        event = inbox.get(0.0 if stop.is_set() else _POLL_S)
        if isinstance(event, Received):
            yield event
        elif stop.is_set():
            return


class Listener:
    """A subscriber that writes scans, odometry, beliefs and the map to a file."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session, self._causes = session, CauseCounter()
        self._inbox: Events = Inbox(_KEPT)
        self._last: Scan | None = None
        self.steps = 0
        subscribe(session, keys.SCAN, Scan, self._inbox, "scan")
        subscribe(session, keys.ODOMETRY, OdometryReading, self._inbox, "odometry")
        subscribe(session, keys.BELIEF, Belief, self._inbox, "belief")

    def write(self, path: Path, stop: StopFlag) -> None:
        """Write received messages until `stop` is set and all messages are written."""
        with RunLog.to(path) as log:
            for received in received_until(stop, self._inbox):
                try:
                    self._write(log, received)
                except MalformedMessageError as error:
                    self._causes.warn(_log, error.cause, error, time.monotonic())

    def _write(self, log: RunLog, received: Received) -> None:
        match received.key:
            case keys.SCAN:
                self._on_scan(log, decode(received.payload, Scan))
            case keys.ODOMETRY:
                log.on_odometry(decode(received.payload, OdometryReading))
            case keys.BELIEF:
                log.on_belief(decode(received.payload, Belief))

    def _on_scan(self, log: RunLog, scan: Scan) -> None:
        last = self._last
        if last and scan.step <= last.step and scan.stamp_ns <= last.stamp_ns:
            return  # the scan was published again
        for one in (*self._lost_before(scan), scan):
            if log.wants_map(one):
                self._write_map(log, one)
            log.on_scan(one)
            self.steps += 1
        self._last = scan

    def _lost_before(self, scan: Scan) -> tuple[Scan, ...]:
        """Return the scans that were lost before a scan, as far as the bridge still has them."""
        if self._last is None or scan.step <= self._last.step + 1:
            return ()
        selector = keys.scan_history(self._last.step + 1, scan.step - 1)
        try:
            return ask(self._session, selector, ScanHistory, timeout_s=_HISTORY_TIMEOUT_S).scans
        except ClusterMclError as error:
            self._causes.warn(_log, "steps lost", error, time.monotonic())
            return ()

    def _write_map(self, log: RunLog, scan: Scan) -> None:
        try:
            message = ask(self._session, keys.MAP, MapMessage, timeout_s=_MAP_TIMEOUT_S)
            log.on_map(from_message(message), scan.stamp_ns)
        except ClusterMclError as error:
            self._causes.warn(_log, "no map", error, time.monotonic())
