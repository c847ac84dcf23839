"""Readings of a recording, for the bridge and for runs without a network."""

import logging
from collections.abc import Iterator
from typing import Protocol

from process_runtime.settings import BridgeSettings
from protocol.errors import RecordingError
from protocol.steps import Observation, Reading, Scan
from recordings.recording import Recording, open_recording
from sensor_bridge.step_maker import StepMaker, steps_from

_NAMED_LINES = 10

_log = logging.getLogger(__name__)


class Source(Protocol):
    """Readings that no robot publishes."""

    @property
    def steps(self) -> int | None:
        """Number of steps that it makes; None: endless."""

    def next_reading(self) -> Reading | Observation | None:
        """Return the next reading in the order of time; None at the end."""


class RecordedSource:
    """A source that yields the readings of a recording."""

    def __init__(self, path: str, settings: BridgeSettings) -> None:
        recording = opened(path, settings)
        self._readings = iter(recording.readings)
        self.steps: int = sum(1 for _ in steps_of(recording, settings, map_digest=""))

    def next_reading(self) -> Reading | None:
        """Return the next reading in the order of time; None at the end."""
        return next(self._readings, None)


def opened(path: str, settings: BridgeSettings) -> Recording:
    """Open a recording, and log all skipped lines in one warning.

    Raises:
        RecordingError: it cannot be used.
    """
    recording = open_recording(path, settings)
    if warning := left_out(recording):
        _log.warning(warning)
    return recording


def left_out(recording: Recording) -> str | None:
    """Return a sentence about the skipped lines; None: no line was skipped."""
    skipped = recording.skipped
    if not skipped:
        return None
    numbers = ", ".join(str(line.line_number) for line in skipped[:_NAMED_LINES])
    more = ", ..." if len(skipped) > _NAMED_LINES else ""
    lines = "line" if len(skipped) == 1 else "lines"
    first = skipped[0]
    return (
        f"{recording.path}:{first.line_number}: {len(skipped)} bad {lines} left out "
        f"({numbers}{more}); the first: {first.problem}"
    )


def steps_of(recording: Recording, settings: BridgeSettings, map_digest: str) -> Iterator[Scan]:
    """Yield all steps of a recording, without a network; `Scan.last` marks the last one.

    Raises:
        RecordingError: no scan of the recording could be used, with the causes.
    """
    maker = StepMaker(settings, map_digest, "bridge")
    made = False
    for scan in steps_from(recording.readings, maker):
        made = True
        yield scan
    if not made:
        causes = ", ".join(f"{cause}: {count}" for cause, count in maker.dropped.items())
        problem = f"none of its {recording.laser_count} scans can be used ({causes})"
        raise RecordingError(recording.path, problem)
