"""Readings of a recording, for the bridge and for runs without a network."""

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass

from msgspec.structs import replace

from clustermcl.protocol.causes import key_of
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.steps import LaserReading, Observation, OdometryReading, Reading, Scan
from clustermcl.recordings.recording import Recording, open_recording
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker

_log = logging.getLogger(__name__)
_MOST_LEFT_S = 2.0
"""How long scans may go on after odometry without a warning [s]."""


@dataclass(frozen=True)
class Source:
    """Readings that no robot publishes."""

    readings: Iterator[Reading | Observation]
    """In the order of time."""
    steps: int | None
    """Number of steps that they make; None: endless."""


def recorded_source(path: str, settings: BridgeSettings) -> Source:
    """Return the readings of a recording; errors as `steps_of`."""
    recording = opened(path, settings)
    steps = sum(1 for _ in steps_of(recording, settings, map_digest=""))
    return Source(iter(recording.readings), steps)


def opened(path: str, settings: BridgeSettings) -> Recording:
    """Open a recording; log all skipped lines in one warning, and scans after odometry's end.

    Raises:
        RecordingError: it cannot be used.
    """
    recording = open_recording(path, settings)
    if skipped := recording.skipped:
        lines = "line" if len(skipped) == 1 else "lines"
        _log.warning(
            "%s:%d: %d bad %s left out; the first: %s",
            *(path, skipped[0].line_number, len(skipped), lines, skipped[0].problem),
        )
    last_ns = {type(reading): reading.stamp_ns for reading in recording.readings}
    left_s = (last_ns[LaserReading] - last_ns.get(OdometryReading, math.inf)) / 1e9
    if left_s > _MOST_LEFT_S:
        _log.warning("%s: odometry ends %.0f s before the scans, which are left out", path, left_s)
    return recording


def steps_of(
    recording: Recording, settings: BridgeSettings, map_digest: str, floors: Floors = ONE_MAP
) -> Iterator[Scan]:
    """Yield all steps of a recording, without a network; `Scan.last` marks the last one.

    Raises:
        RecordingError: no scan of the recording could be used, with the causes.
    """
    maker = StepMaker(settings, map_digest, "bridge", floors=floors)
    held: Scan | None = None
    for scan in maker.all_steps(recording.readings):
        if held is not None:
            yield held
        held = scan
    if held is None:
        causes = ", ".join(f"{key_of(cause)}: {count}" for cause, count in maker.dropped.items())
        problem = f"none of its {recording.laser_count} scans can be used ({causes})"
        raise RecordingError(recording.path, problem)
    yield replace(held, last=True)
