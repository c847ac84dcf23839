"""Coordinators whose events are written down, and what a replay makes of it."""

import weakref
from pathlib import Path

import msgspec
from msgspec.structs import replace

from clustermcl.coordinator.coordinator import Coordinator, Started
from clustermcl.coordinator.events import Event
from clustermcl.coordinator.instructions import Instruction
from clustermcl.coordinator.recorder.flight_recorder import FlightRecorder
from clustermcl.coordinator.recorder.records import Head, RecordedEvent, freeze
from clustermcl.coordinator.recorder.replay import Believed, Happening, replayed
from clustermcl.coordinator.recorder.ring import EVENTS, HEAD, Ring, files_in
from clustermcl.coordinator.recovery import Term
from clustermcl.coordinator.state import CoordinatorState
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.codec import encode
from clustermcl.recordings.run_log import RunLog, RunLogReader
from tests.unit.coordinator.reports import started

VERSION = "test"


STARTED = started(term=7)


def head(version: str = VERSION) -> Head:
    return Head(
        version=version,
        now_ns=0,
        wall_ns=0,
        first_event=0,
        snapshot=freeze(replace(STARTED, version=version).coordinator()),
    )


def events_in(folder: Path) -> list[Event]:
    messages = (message for file in files_in(folder) for message in RunLogReader(file).messages())
    decode = msgspec.msgpack.Decoder(list[RecordedEvent]).decode
    batches = [decode(message.data) for message in messages if message.topic == EVENTS]
    return [reported.event for batch in batches for reported in batch]


def write_file(path: Path, head: Head | msgspec.Raw, *events: RecordedEvent | msgspec.Raw) -> None:
    with RunLog(path) as log:
        log.write(HEAD, head, 0, packed=True)
        for event in events:
            log.write(EVENTS, [event], 1, packed=True)


class RecordedCoordinator:
    """Behaves as a coordinator; all is on disk after each event."""

    def __init__(self, started: Started, ring: Ring) -> None:
        self.coordinator = started.coordinator()
        self.ring, self.recorder = ring, FlightRecorder(self.coordinator, ring)
        weakref.finalize(self, ring.close)

    @property
    def term(self) -> Term:
        return self.coordinator.term

    @property
    def state(self) -> CoordinatorState:
        return self.coordinator.state

    def handle(self, event: Event, now_ns: int) -> list[Instruction]:
        instructions = self.recorder.handle(event, now_ns)
        self.recorder.flush()
        return instructions


class Recordings:
    """Makes such coordinators, all in one folder."""

    def __init__(self, folder: Path, max_bytes: int = 10_000_000) -> None:
        self.folder, self._max_bytes = folder, max_bytes
        self.made: list[RecordedCoordinator] = []

    def make(self, started: Started) -> Coordinator:
        ring = Ring(self.folder, started.term, self._max_bytes)
        self.made.append(RecordedCoordinator(started, ring))
        return self.made[-1]  # type: ignore[return-value] # it behaves as one

    def replay(self) -> list[Happening]:
        return [happening for _, happening in replayed(self.folder, VERSION)]


def beliefs(happenings: list[Happening]) -> list[Belief]:
    """Those replayed; each is the recorded one."""
    found = [happening for happening in happenings if isinstance(happening, Believed)]
    assert all(happening.same for happening in found)
    return [happening.belief for happening in found]


def as_bytes(reported: list[Belief]) -> list[bytes]:
    return [encode(belief) for belief in reported]
