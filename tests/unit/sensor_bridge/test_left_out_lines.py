from pathlib import Path

import pytest

from recordings.log_file import SkippedLine
from recordings.recording import Recording
from sensor_bridge.recorded import left_out

X, CUT = "'x' is not a number", "cut"


@pytest.mark.parametrize(("skipped", "words"), [
    ((SkippedLine(3, X), SkippedLine(9, CUT)),
     f"robot.log:3: 2 bad lines left out (3, 9); the first: {X}"),
    (tuple(SkippedLine(number, CUT) for number in range(1, 40)),
     "39 bad lines left out (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, ...)"),
    ((), "None"),
], ids=["the first is explained", "ten of many are named", "no bad line, no warning"])  # fmt: skip
def test_bad_lines_that_are_left_out_are_counted(
    skipped: tuple[SkippedLine, ...], words: str
) -> None:
    assert words in str(left_out(Recording(Path("robot.log"), (), skipped)))
