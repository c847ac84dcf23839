"""Coordinators whose events are written down, and what a replay makes of it."""

import weakref
from pathlib import Path

from coordinator.coordinator import Coordinator
from coordinator.events import Event
from coordinator.instructions import Instruction
from coordinator.recorder.flight_recorder import FlightRecorder
from coordinator.recorder.records import Started
from coordinator.recorder.replay import Believed, Happening, replayed
from coordinator.recorder.ring import Ring
from protocol.answers import Belief
from protocol.codec import encode

VERSION = "test"


class RecordedCoordinator:
    """Behaves as a coordinator; all is on disk after each event."""

    def __init__(self, started: Started, ring: Ring) -> None:
        self.coordinator = started.coordinator()
        self.ring, self.recorder = ring, FlightRecorder(self.coordinator, started, ring)
        weakref.finalize(self, ring.close)

    @property
    def begun(self) -> bool:
        return self.coordinator.begun

    @property
    def map_digest(self) -> str:
        return self.coordinator.map_digest

    @property
    def outranked_by(self) -> int | None:
        return self.coordinator.outranked_by

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


def as_bytes(told: list[Belief]) -> list[bytes]:
    return [encode(belief) for belief in told]
