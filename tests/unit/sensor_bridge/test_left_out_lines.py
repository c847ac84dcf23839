from pathlib import Path

from recordings.log_file import SkippedLine
from recordings.recording import Recording
from sensor_bridge.recorded import left_out


def recording(*skipped: SkippedLine) -> Recording:
    return Recording(Path("robot.log"), (), skipped)


def test_lines_left_out_are_counted_and_named_and_the_first_is_explained() -> None:
    lines = (SkippedLine(3, "'x' is not a number"), SkippedLine(9, "cut"))
    assert left_out(recording(*lines)) == (
        "robot.log:3: 2 bad lines left out (3, 9); the first: 'x' is not a number"
    )


def test_the_first_ten_of_many_bad_lines_are_named() -> None:
    output = left_out(recording(*(SkippedLine(number, "cut") for number in range(1, 40))))
    assert output is not None
    assert "39 bad lines left out (1, 2, 3, 4, 5, 6, 7, 8, 9, 10, ...)" in output


def test_a_recording_without_bad_lines_gives_no_warning() -> None:
    assert left_out(recording()) is None
