"""From a file to readings in the order of time, whatever the format of the recording."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from particle_filter.extensions import extension, names
from process_runtime.settings import BridgeSettings
from protocol.arrays import ArrayBlob
from protocol.errors import RecordingError
from protocol.message import PoseTuple
from protocol.steps import LaserReading, OdometryReading, Reading
from recordings.bag_file import is_bag
from recordings.carmen_log import CarmenParser, is_carmen_line
from recordings.log_file import (
    Entry,
    LaserEntry,
    LogFile,
    LogParser,
    OdometryEntry,
    SkippedLine,
)
from recordings.no_return import range_limit_m
from recordings.recording_time import merged, plausible
from recordings.run_log import is_run_log, playback
from recordings.wean_log import WeanParser, is_wean_line

SENDER = "recording"
"""Sender of the readings of a recording."""

_FORMAT_LINES = 1000
_BETWEEN_READINGS_NS = 1_000_000_000
"""Between readings of an own reader that have no stamps, as `ClusterMCL` takes them."""


@dataclass(frozen=True)
class Recording:
    """Everything a recording holds for localizing.

    Args:
        path: the file.
        readings: in the order in which they happened. Odometry has times that never decrease;
            scans keep the stamps of the file, so that a reference finds them.
        skipped: lines that were left out.
        duration_s: from the first reading to the last.
        laser_count: scans among the readings.
    """

    path: Path
    readings: Sequence[Reading]
    skipped: tuple[SkippedLine, ...]
    duration_s: float
    laser_count: int


class OwnReading(Protocol):
    """What a reader of the user's own yields; `clustermcl.Reading` is one."""

    def as_message(self, stamp_ns: int, robot_from_laser: PoseTuple) -> Reading:
        """The reading as a robot publishes it; the arguments replace what it does not know."""


def open_recording(path: Path | str, settings: BridgeSettings) -> Recording:
    """Read a run log, a ROS bag, a Wean Hall or CARMEN log, or what an installed reader can read.

    The format shows in the content.

    Args:
        path: the file, perhaps packed by gzip or xz, or the folder of a rosbag2.
        settings: where the laser sits on the robot, if the recording does not say; which topics
            and frames of a bag are meant, if there are several.

    Raises:
        RecordingError: the file is missing, no recording, holds no scan, or leaves a choice. Bad
            lines, and the end of a file that is cut off, are skipped and named instead; of a
            bag, a line is a message that was read.
    """
    path = Path(path)
    mount = (settings.laser_x_m, settings.laser_y_m, settings.laser_heading_rad)
    for name in names("recording_reader"):
        try:
            own = extension("recording_reader", name)(path)
            if own is not None:
                return _own_recording(path, own, mount)
        except (OSError, ValueError) as error:
            raise RecordingError(path, f"reader {name!r}: {error}") from error
    if is_run_log(path):
        entries, skipped = playback(path)
    elif is_bag(path):
        # Imported here: bags need scipy for turns, and a live robot's bridge is to start fast.
        from recordings.ros_bag import bag_entries  # noqa: PLC0415

        entries, skipped = bag_entries(path, settings)
    else:
        entries, skipped = _entries(path)
    entries, misplaced = plausible(entries)
    skipped += misplaced
    lasers = [entry for entry in entries if isinstance(entry, LaserEntry)]
    if not lasers:
        raise RecordingError(path, _no_scan(entries, skipped))
    limit_m = range_limit_m(entry.ranges for entry in lasers)
    entries, times = merged(entries)
    return Recording(
        path=path,
        readings=[_reading(*timed, limit_m, mount) for timed in zip(entries, times, strict=True)],
        skipped=tuple(sorted(skipped, key=lambda line: line.line_number)),
        duration_s=(times[-1] - times[0]) / 1e9,
        laser_count=len(lasers),
    )


def _own_recording(path: Path, own: Iterable[OwnReading], mount: PoseTuple) -> Recording:
    readings: list[Reading] = []
    for reading in own:
        next_ns = readings[-1].stamp_ns + _BETWEEN_READINGS_NS if readings else 0
        readings.append(reading.as_message(next_ns, mount))
    laser_count = sum(isinstance(reading, LaserReading) for reading in readings)
    if not laser_count:
        raise RecordingError(path, f"no scan in it: {len(readings)} readings of odometry")
    duration_s = (readings[-1].stamp_ns - readings[0].stamp_ns) / 1e9
    return Recording(path, readings, (), duration_s, laser_count)


def _entries(path: Path) -> tuple[list[Entry], list[SkippedLine]]:
    """What the lines say, in the order of the file, and the lines that say nothing."""
    log, parser = LogFile(path), None
    entries: list[Entry] = []
    skipped: list[SkippedLine] = []
    for number, line in log.lines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        parser = parser or _parser_for(words)
        try:
            entry = parser.parse(number, words) if parser else _stranger(words)
        except ValueError as problem:
            skipped.append(SkippedLine(number, str(problem)))
            if parser is None and len(skipped) >= _FORMAT_LINES:
                break
        else:
            entries += [entry] if entry else []
    if parser is None:
        raise RecordingError(path, _not_recognised(bool(skipped), log.broken))
    return parser.finished(entries), skipped + ([log.broken] if log.broken else [])


def _parser_for(words: Sequence[str]) -> LogParser | None:
    """The format that a line is of, if it is of any."""
    if is_carmen_line(words):
        return CarmenParser()
    return WeanParser() if is_wean_line(words) else None


def _stranger(words: Sequence[str]) -> Entry | None:
    raise ValueError(f"unknown kind of line {words[0]!r:.20}")


def _not_recognised(any_line: bool, broken: SkippedLine | None) -> str:
    if broken:
        return broken.problem
    if not any_line:
        return "empty; expected a Wean Hall or CARMEN log"
    return "not a recording: no line of a Wean Hall log (O, L) or a CARMEN log (ODOM, FLASER ...)"


def _no_scan(entries: Sequence[Entry], skipped: Sequence[SkippedLine]) -> str:
    problem = f"no scan in it: {len(entries)} lines of odometry, {len(skipped)} bad lines"
    if skipped:
        problem += f", first line {skipped[0].line_number}: {skipped[0].problem}"
    return problem


def _reading(entry: Entry, time_ns: int, limit_m: float, mount: PoseTuple) -> Reading:
    if isinstance(entry, OdometryEntry):
        return OdometryReading(
            sender=SENDER, stamp_ns=time_ns, odom_from_robot=entry.odom_from_robot
        )
    return LaserReading(
        sender=SENDER,
        stamp_ns=entry.stamp_ns,
        ranges=ArrayBlob.of(entry.ranges, "float32"),
        angle_min_rad=entry.angle_min_rad,
        angle_step_rad=entry.angle_step_rad,
        range_max_m=min(limit_m, entry.range_limit_m or limit_m),
        robot_from_laser=entry.robot_from_laser or mount,
        odom_from_robot=entry.odom_from_robot,
        laser=entry.laser,
    )
