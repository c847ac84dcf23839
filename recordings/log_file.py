"""The lines of a recording, and the entries that they become, whatever the format."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from process_runtime.compressed import (
    BROKEN_STREAM_ERRORS,
    MAX_FILE_BYTES,
    broken_stream_problem,
    open_decompressed,
    os_problem,
    too_long_problem,
)
from protocol.errors import InputFileError, RecordingError
from protocol.message import MAX_POSE_M, PoseTuple

_MAX_LINE_BYTES = 1_000_000
_MAX_STAMP_S = Decimal(9_000_000_000)  # the year 2255; its nanoseconds fit into 64 bits


@dataclass(frozen=True)
class SkippedLine:
    """A line that was left out, and why."""

    line_number: int
    problem: str


@dataclass(frozen=True)
class OdometryEntry:
    """One line of odometry."""

    line_number: int
    stamp_ns: int
    odom_from_robot: PoseTuple


@dataclass(frozen=True)
class LaserEntry:
    """One scan. What the line does not say is None."""

    line_number: int
    stamp_ns: int
    ranges: NDArray[np.float32]
    angle_min_rad: float
    angle_step_rad: float
    robot_from_laser: PoseTuple | None
    odom_from_robot: PoseTuple | None
    range_limit_m: float | None = None
    laser: str = ""
    """Its name, where there may be several."""


Entry = OdometryEntry | LaserEntry


class LogParser(Protocol):
    """A format of recordings."""

    def parse(self, line_number: int, words: Sequence[str]) -> Entry | None:
        """Read one line; None where it holds no reading.

        Raises:
            ValueError: with a sentence for the reader: the line is cut or not of this format.
        """

    def finished(self, entries: Sequence[Entry]) -> list[Entry]:
        """The entries, corrected by what only all lines together show."""


class LogFile:
    """Numbered lines of a text that may be compressed and cut off.

    After all lines were read, `broken` says where and how a compressed stream ended early.

    Args:
        path: the file.
        error: what to raise when it cannot be read.
    """

    def __init__(self, path: Path, error: type[InputFileError] = RecordingError) -> None:
        self._path, self._error = path, error
        self.broken: SkippedLine | None = None

    def lines(self) -> Iterator[tuple[int, str]]:
        """Line numbers, from 1, and lines.

        Raises:
            InputFileError: as `error`: the file cannot be opened or read, or is too long.
        """
        number, left = 0, MAX_FILE_BYTES
        try:
            with open_decompressed(self._path) as stream:
                while line := stream.readline(_MAX_LINE_BYTES):
                    number, left = number + 1, left - len(line)
                    if left < 0:
                        raise self._error(self._path, too_long_problem(), line=number)
                    yield number, line.decode("utf-8", errors="replace")
        except BROKEN_STREAM_ERRORS as broken:
            self.broken = SkippedLine(number + 1, broken_stream_problem(broken))
        except OSError as failed:
            raise self._error(self._path, os_problem(failed)) from failed


def stamp_ns_of(text: str) -> int:
    """A time in seconds, as written, in nanoseconds: exact, so that equal texts meet again.

    Raises:
        ValueError: it is no time.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"the time {text!r} is not a number") from None
    if not seconds.is_finite() or abs(seconds) > _MAX_STAMP_S:
        raise ValueError(f"the time {text!r} is no time in seconds")
    return int((seconds * 1_000_000_000).to_integral_value())


def numbers_of(words: Sequence[str]) -> list[float]:
    """Numbers, as written.

    Raises:
        ValueError: a word is no number.
    """
    numbers: list[float] = []
    for word in words:
        try:
            numbers.append(float(word))
        except ValueError:
            raise ValueError(f"{word!r} is not a number") from None
    return numbers


def ranges_of(words: Sequence[str], m_per_unit: float = 1.0) -> NDArray[np.float32]:
    """(B,) ranges [m]; what is not finite stays so and counts as no return.

    Raises:
        ValueError: a word is no number.
    """
    with np.errstate(over="ignore"):  # 1e300 m becomes infinite
        return (np.array(numbers_of(words)) * m_per_unit).astype(np.float32)


def pose_of(words: Sequence[str], m_per_unit: float = 1.0) -> PoseTuple:
    """A pose from x, y and heading [rad].

    Raises:
        ValueError: a word is no number, or the numbers are no pose.
    """
    x, y, heading = numbers_of(words)
    x, y = x * m_per_unit, y * m_per_unit
    if not (abs(x) < MAX_POSE_M and abs(y) < MAX_POSE_M and math.isfinite(heading)):
        raise ValueError(f"({' '.join(words)}) is no pose")
    return x, y, math.remainder(heading, math.tau)
