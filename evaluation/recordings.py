"""Opens recordings for commands, with a warning of bad lines."""

import logging

from process_runtime.settings import BridgeSettings
from recordings.recording import Recording, open_recording
from sensor_bridge.recorded import steps_of

_NAMED_LINES = 10

_log = logging.getLogger(__name__)


def opened(path: str, settings: BridgeSettings) -> Recording:
    """Open a recording and warn of skipped lines.

    Raises:
        RecordingError: it cannot be used.
    """
    recording = open_recording(path, settings)
    if warning := left_out(recording):
        _log.warning(warning)
    return recording


def counted_steps(path: str, settings: BridgeSettings) -> int:
    """Count the steps of a recording.

    Raises:
        RecordingError: it cannot be used.
    """
    return sum(1 for _ in steps_of(opened(path, settings), settings, map_digest=""))


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
