from pathlib import Path

import pytest

from process_runtime.settings import BridgeSettings
from recordings.log_file import SkippedLine
from recordings.recording import Recording
from sensor_bridge import recorded

X, CUT = "'x' is not a number", "cut"


@pytest.mark.parametrize(("skipped", "words"), [
    ((SkippedLine(3, X), SkippedLine(9, CUT)),
     f"robot.log:3: 2 bad lines left out (3, 9); the first: {X}"),
    (tuple(SkippedLine(number, CUT) for number in range(1, 40)),
     "39 bad lines left out (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, ...)"),
    ((), ""),
], ids=["the first is explained", "ten of many are named", "no bad line, no warning"])  # fmt: skip
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
