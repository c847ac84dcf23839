"""Readings of a recording, for the bridge and for runs without a network."""

import logging
from collections.abc import Iterator
from typing import Protocol

from process_runtime.settings import BridgeSettings
from protocol.errors import RecordingError
from protocol.steps import Observation, Reading, Scan
from recordings.recording import Recording, open_recording
from sensor_bridge.step_maker import StepMaker, steps_from

_log = logging.getLogger(__name__)


class Source(Protocol):
    """Readings that no robot publishes."""

    steps: int | None
    """Number of steps that it makes; None: endless."""

    def next_reading(self) -> Reading | Observation | None:
        """Return the next reading in the order of time; None at the end."""


class RecordedSource:
    """A source that yields the readings of a recording."""

    def __init__(self, path: str, settings: BridgeSettings) -> None:
        recording = open_recording(path, settings)
        for skipped in recording.skipped:
            _log.warning("%s:%d left out: %s", path, skipped.line_number, skipped.problem)
        self._readings = iter(recording.readings)
        self.steps: int | None = sum(1 for _ in steps_of(recording, settings, map_digest=""))

    def next_reading(self) -> Reading | None:
        """Return the next reading in the order of time; None at the end."""
        return next(self._readings, None)


def steps_of(
    recording: Recording,
    settings: BridgeSettings,
    map_digest: str,
    *,
    sender: str = "bridge",
    lockstep: bool = False,
) -> Iterator[Scan]:
    """Yield all steps of a recording, without a network; `Scan.last` marks the last one.

    Raises:
        RecordingError: no scan of the recording could be used, with the causes.
    """
    maker = StepMaker(settings, map_digest, sender, lockstep=lockstep)
    made = False
    for scan in steps_from(recording.readings, maker):
        made = True
        yield scan
    if not made:
        causes = ", ".join(f"{cause}: {count}" for cause, count in maker.dropped.items())
        problem = f"none of its {recording.laser_count} scans can be used ({causes})"
        raise RecordingError(recording.path, problem)
