"""Reads lines of text recordings; defines the entries into which recordings are parsed."""

from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import NamedTuple

from clustermcl.protocol.errors import InputFileError, RecordingError
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import OdometryReading, Reading
from clustermcl.runtime import compressed

SENDER = "recording"
"""Sender of all readings."""
_MAX_LINE_BYTES = 1_000_000
_MAX_STAMP_S = Decimal(9_000_000_000)  # the year 2255; its nanoseconds fit into 64 bits


@dataclass(frozen=True, slots=True)
class SkippedLine:
    """The number of a skipped line, and why it was skipped."""

    line_number: int
    problem: str


class Entry(NamedTuple):
    """A reading in a line of a log, or in a message of a bag or of a run.

    A `range_max_m` that the recording lacks is infinite.
    """

    line_number: int
    reading: Reading


def odometry_entry(number: int, stamp_ns: int, pose: PoseTuple) -> Entry:
    reading = OdometryReading(sender=SENDER, stamp_ns=stamp_ns, odom_from_robot=pose)
    return Entry(number, reading)


def words_of_lines(
    path: Path, broken: list[SkippedLine], error: type[InputFileError] = RecordingError
) -> Iterator[tuple[int, list[str]]]:
    """Yield number, from 1, and words of the lines of a text file, without blanks and comments.

    If a compressed stream ends early, `broken` gets where and why.

    Raises:
        InputFileError: of the type `error`: the file cannot be opened or read, or is too long.
    """
    number = 0
    try:
        most = compressed.most_unpacked(path.stat().st_size, compressed.MAX_TEXT_BYTES)
        most = left = min(most, compressed.MAX_FILE_BYTES)
        with compressed.open_decompressed(path) as stream:
            while line := stream.readline(_MAX_LINE_BYTES):
                number, left = number + 1, left - len(line)
                if left < 0:
                    raise error(path, compressed.too_long_problem(most), line=number)
                words = line.decode("utf-8", errors="replace").split()
                if words and not words[0].startswith("#"):
                    yield number, words
    except compressed.BROKEN_STREAM_ERRORS as problem:
        broken.append(SkippedLine(number + 1, compressed.broken_stream_problem(problem)))
    except OSError as failed:
        raise error(path, compressed.os_problem(failed)) from failed


def stamp_ns_of(text: str) -> int:
    """Convert a decimal time in seconds to nanoseconds, without rounding errors."""
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"the time {text!r} is not a number") from None
    if not seconds.is_finite() or abs(seconds) > _MAX_STAMP_S:
        raise ValueError(f"the time {text!r} is not a time in seconds")
    return int((seconds * 1_000_000_000).to_integral_value())
