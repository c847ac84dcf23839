"""Records a coordinator's events in a separate thread, so a slow disk delays no step."""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import TypeAlias

from clustermcl.coordinator.coordinator import Coordinator
from clustermcl.coordinator.events import Event
from clustermcl.coordinator.instructions import Instruction
from clustermcl.coordinator.recorder import records
from clustermcl.coordinator.recorder.ring import EVENTS, Ring
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.job_events import JobEvents
from clustermcl.recordings.foxglove import log_line
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.run_log import JOB_EVENTS, LINES, RunLog
from clustermcl.runtime.logs import CauseCounter
from clustermcl.runtime.output_files import OutputError
from clustermcl.runtime.threads import disk_thread

FLUSH_S = 0.5
"""Time between two writes to the disk; a killed process loses at most this time [s]."""
MAX_QUEUED = 2_048
"""Largest number of waiting entries: half a minute of ten steps a second with ten clusters."""
LAST_WRITE_S = 0.9
"""Longest wait for the disk at the end [s]."""
RETRY_S = 10.0
"""Time between two attempts to write to a disk that fails [s]."""

_Entry: TypeAlias = records.Head | records.RecordedEvent | GridMap | Belief | JobEvents

_log = logging.getLogger(__name__)


class FlightRecorder:
    """Passes events to a coordinator, and records them and the resulting beliefs.

    The coordinator receives events only from this object. Without a `ring` nothing is recorded.
    Events that cannot be written are counted. After a gap a new file begins with the coordinator's
    present state.
    """

    def __init__(self, coordinator: Coordinator, ring: Ring | None) -> None:
        self._coordinator, self._ring = coordinator, ring
        self._queue: deque[_Entry] = deque()
        self._events = self._dropped = 0
        # `flush` sets `_begin_file` from the thread when a file is full.
        self._recording, self._begin_file = False, ring is not None
        self._closed = threading.Event()
        # Used only in the thread:
        self._unflushed, self._unwritten, self._retry_s = 0, 0, 0.0
        self._asked, self._causes = True, CauseCounter()
        self._wall_from_now_ns, self._at_ns = 0, 0
        self._map: GridMap | None = None
        self._batch: list[records.RecordedEvent] = []

    @property
    def lost(self) -> dict[str, int]:
        count = self._dropped + self._unwritten
        return {Cause.NOT_RECORDED: count} if count else {}

    def handle(self, event: Event, now_ns: int) -> list[Instruction]:
        if self._ring is None:
            return self._coordinator.handle(event, now_ns)
        self._enqueue(event, now_ns)
        instructions = self._coordinator.handle(event, now_ns)
        if self._recording:
            self._queue += [do for do in instructions if isinstance(do, (Belief, JobEvents))]
        return instructions

    def on_map(self, grid_map: GridMap) -> None:
        """Record the map, with which each file begins; may be called in any thread."""
        if self._ring is not None:
            self._queue.append(grid_map)

    def running(self) -> AbstractContextManager[None]:
        """Write events within the ``with`` block, and at its end those that wait, if it is soon."""
        if self._ring is None:
            return nullcontext()
        run = partial(self._run, self._ring)
        return disk_thread(run, "flight recorder", self._closed.set, LAST_WRITE_S)

    # --- in the thread of the loop

    def _enqueue(self, event: Event, now_ns: int) -> None:
        if self._begin_file and len(self._queue) < MAX_QUEUED // 2:
            self._recording, self._begin_file = True, False
            head = records.Head(
                version=self._coordinator.version,
                now_ns=now_ns,
                wall_ns=time.time_ns(),
                first_event=self._events,
                snapshot=records.freeze(self._coordinator),
            )
            self._queue.append(head)
        self._events += 1
        if self._recording and len(self._queue) >= MAX_QUEUED:
            self._recording, self._begin_file = False, True
        if self._recording:
            self._queue.append(records.RecordedEvent(now_ns, event))
        else:
            self._dropped += 1

    # --- in its own thread

    def _run(self, ring: Ring) -> None:
        last = False
        while not last:
            last = self._closed.wait(FLUSH_S)
            self.flush()
        ring.close()

    def flush(self) -> None:
        """Write all waiting entries, and request a new file when one is due."""
        ring = self._ring
        assert ring is not None  # otherwise there is no thread
        for entry in [self._queue.popleft() for _ in range(len(self._queue))]:
            if isinstance(entry, records.Head):
                self._guarded(self._flush, ring)
            self._unflushed += isinstance(entry, records.RecordedEvent)
            self._guarded(self._write, ring, entry)
        self._guarded(self._flush, ring)
        due = ring.is_full if ring.log else time.monotonic() >= self._retry_s
        if due and not self._asked:
            self._asked = self._begin_file = True

    def _guarded(self, write: Callable[..., None], ring: Ring, *entry: _Entry) -> None:
        try:
            write(ring, *entry)
        except (OSError, OutputError) as error:
            ring.close(broken=True)
            now_s = time.monotonic()
            problem = "the flight recorder cannot write, and will try again"
            self._causes.warn(_log, problem, error, now_s)
            was_removed = isinstance(error, FileNotFoundError)
            self._retry_s = now_s + (0.0 if was_removed else RETRY_S)

    def _flush(self, ring: Ring) -> None:
        """Write to the disk; count the events that are lost if this fails."""
        unflushed, self._unflushed = self._unflushed, 0
        self._unwritten += unflushed
        self._write_batch(ring.log)
        ring.flush()
        if ring.log is not None:
            self._unwritten -= unflushed

    def _write_batch(self, log: RunLog | None) -> None:
        """Write events as one message, because each message costs about 50 bytes and 20 us."""
        batch, self._batch = self._batch, []
        if batch and log is not None:
            log.write(EVENTS, batch, self._at_ns, packed=True)

    def _write(self, ring: Ring, entry: _Entry) -> None:
        log = ring.log
        match entry:
            case records.Head():
                self._asked = False
                log = ring.begin(entry)
                self._wall_from_now_ns, self._at_ns = entry.wall_ns - entry.now_ns, entry.wall_ns
                if self._map is not None:
                    log.on_map(self._map, self._at_ns)
            case GridMap():
                self._map = entry
                if log is not None:
                    log.on_map(entry, self._at_ns)
            case records.RecordedEvent(now_ns, event) if log is not None:
                self._at_ns = self._wall_from_now_ns + now_ns
                self._batch.append(records.without_bulk(entry))
                for scan in records.scans_in(event):
                    log.on_scan(scan, self._at_ns)
                self._write_lines(log, records.happened(event))
            case Belief() if log is not None:
                self._write_batch(log)  # a replay expects a belief after its event
                log.on_belief(entry, self._at_ns)
            case JobEvents() if log is not None:
                log.write(JOB_EVENTS, entry, self._at_ns)
                self._write_lines(log, records.happened_to([entry]))

    def _write_lines(self, log: RunLog, lines: Iterable[records.Happened]) -> None:
        for line in lines:
            log.write(LINES, log_line(f"{line.kind}: {line.about}", self._at_ns), self._at_ns)
