from pathlib import Path

import pytest

from clustermcl.protocol.errors import RecordingError
from clustermcl.recordings.log_file import SkippedLine
from clustermcl.recordings.recording import Recording
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge import recorded
from clustermcl.sensor_bridge.recorded import steps_of
from tests.unit.recordings.logs import flaser, recording_of


def test_a_recording_without_a_usable_scan_is_refused(tmp_path: Path) -> None:
    recording = recording_of(tmp_path, *(flaser(t, ranges=["nan"] * 180) for t in range(3)))
    with pytest.raises(RecordingError, match=r"none of its 3 scans can be used \(no_returns: 3\)"):
        list(steps_of(recording, BridgeSettings(), "digest"))


X = "'x' is not a number"


@pytest.mark.parametrize(("skipped", "words"), [
    ((SkippedLine(3, X), SkippedLine(9, "cut")),
     f"robot.log:3: 2 bad lines left out; the first: {X}"),
    ((), ""),
], ids=["the first is explained", "no bad line, no warning"])  # fmt: skip
def test_bad_lines_that_are_left_out_are_counted(
    skipped: tuple[SkippedLine, ...],
    words: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    recording = Recording(Path("robot.log"), (), skipped)
    monkeypatch.setattr(recorded, "open_recording", lambda *_: recording)
    recorded.opened("robot.log", BridgeSettings())
    assert words in caplog.text
    assert bool(skipped) == bool(caplog.text)
