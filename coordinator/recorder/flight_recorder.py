"""Writes down what the coordinator is told, in a thread of its own: a slow disk delays no step."""

import logging
import platform
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from coordinator.coordinator import Coordinator
from coordinator.events import Event
from coordinator.instructions import Instruction, PublishBelief
from coordinator.recorder.records import (
    BeliefsSaid,
    EventTold,
    Head,
    Record,
    Started,
    without_bulk,
)
from coordinator.recorder.ring import Ring
from coordinator.recorder.snapshot import freeze

FLUSH_S = 0.05
"""So much may be missing at the end after a kill -9."""
MAX_QUEUED = 2_048
"""Records that wait for a slow disk: half a minute at ten steps a second and ten clusters."""
RETRY_S = 10.0
"""A disk that could not be written is tried again after so long."""
LOST = "event not recorded"

_log = logging.getLogger(__name__)


class FlightRecorder:
    """Stands before a coordinator's door: hands events on, and writes them down.

    What cannot be written is counted. After a gap a new file begins, from what the coordinator
    knows then.

    Args:
        coordinator: whose events; nobody else may tell it any.
        started: what it was made with.
        ring: where to; None: nowhere.
    """

    def __init__(self, coordinator: Coordinator, started: Started, ring: Ring | None) -> None:
        self._coordinator, self._ring = coordinator, ring
        self._started = without_bulk(started)
        self._queue: deque[Record | Head] = deque()
        self._events = self._dropped = 0
        self._recording, self._begin_file = (
            False,
            ring is not None,
        )  # the thread asks for a file too
        self._closed = threading.Event()
        # Of the thread:
        self._unwritten, self._retry_s = 0, 0.0
        self._asked, self._failed = True, False

    @property
    def lost(self) -> dict[str, int]:
        """How many events were not written down, by cause; empty for none."""
        count = self._dropped + self._unwritten
        return {LOST: count} if count else {}

    def handle(self, event: Event, now_ns: int) -> list[Instruction]:
        """Tell the coordinator; as `Coordinator.handle`."""
        if self._ring is None:
            return self._coordinator.handle(event, now_ns)
        self._write_down(event, now_ns)
        instructions = self._coordinator.handle(event, now_ns)
        beliefs = tuple(do.belief for do in instructions if isinstance(do, PublishBelief))
        if beliefs and self._recording:
            self._queue.append(BeliefsSaid(beliefs))
        return instructions

    @contextmanager
    def running(self) -> Iterator[None]:
        """Write while the context lasts; what waits is written on the way out."""
        if self._ring is None:
            yield
            return
        thread = threading.Thread(target=self._run, args=(self._ring,), name="flight-recorder")
        thread.start()
        try:
            yield
        finally:
            self._closed.set()
            thread.join()

    # --- in the thread of the loop

    def _write_down(self, event: Event, now_ns: int) -> None:
        if self._begin_file and len(self._queue) < MAX_QUEUED // 2:
            self._recording, self._begin_file = True, False
            self._queue.append(self._head(now_ns))
        self._events += 1
        if self._recording and len(self._queue) >= MAX_QUEUED:
            self._recording, self._begin_file = False, True
        if self._recording:
            self._queue.append(EventTold(now_ns, event))
        else:
            self._dropped += 1

    def _head(self, now_ns: int) -> Head:
        return Head(
            version=self._started.version,
            made_with=f"Python {platform.python_version()}, numpy {np.__version__}, "
            f"{sys.platform} {platform.machine()}",
            now_ns=now_ns,
            wall_ns=time.time_ns(),
            first_event=self._events,
            started=self._started,
            snapshot=freeze(self._coordinator) if self._events else b"",
        )

    # --- in its own thread

    def _run(self, ring: Ring) -> None:
        last = False
        while not last:
            last = self._closed.wait(FLUSH_S)
            self.flush()
        ring.close()

    def flush(self) -> None:
        """Write what waits, and ask for a new file where it is time; the thread calls it."""
        ring, records = self._ring, list[Record]()
        assert ring is not None  # else there is no thread
        for record in [self._queue.popleft() for _ in range(len(self._queue))]:
            if isinstance(record, Head):
                self._write(ring, None, records)
                self._write(ring, record, [])
                records = []
            else:
                records.append(record)
        self._write(ring, None, records)
        due = ring.is_full if ring.is_open else time.monotonic() >= self._retry_s
        if due and not self._asked:
            self._asked = self._begin_file = True

    def _write(self, ring: Ring, head: Head | None, records: list[Record]) -> None:
        try:
            if head is not None:
                self._asked = False
                ring.begin(head)
                self._failed = False
            elif records and ring.is_open:
                ring.write([without_bulk(record) for record in records])
                return
        except OSError as error:
            if not self._failed:
                _log.warning("the flight recorder cannot write, and will try again: %s", error)
            wait_s = 0.0 if isinstance(error, FileNotFoundError) else RETRY_S  # it was removed
            self._failed, self._retry_s = True, time.monotonic() + wait_s
        self._unwritten += sum(isinstance(record, EventTold) for record in records)
