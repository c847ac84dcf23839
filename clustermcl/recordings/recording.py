"""Reads recordings of all formats as readings in the order of time."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.steps import LaserReading, Reading
from clustermcl.recordings.bag_file import is_bag
from clustermcl.recordings.carmen_log import carmen_entries
from clustermcl.recordings.log_file import Entry, SkippedLine
from clustermcl.recordings.run_log import is_run_log, playback
from clustermcl.runtime.compressed import os_problem
from clustermcl.runtime.settings import BridgeSettings

SHORTEST_MARKER_M = 8.0
"""Shortest range that marks a missing return [m]; known lasers use 8.18 m or more."""

_BAND = 0.99  # 81.83 and 81.91 m, or 51.10 to 51.16 m, are the same marker
_NEAR_BAND = 0.8
_MIN_SHARE = 0.001
_MIN_CONTRAST = 10.0
_MIN_MODE = 0.5
_MIN_REACH = 2.0
MAX_DISORDER_NS = 10_000_000_000
"""Largest step back of a stamp, and largest distance from the stamps around it [ns]."""


@dataclass(frozen=True)
class Recording:
    """The content of a recording, for localization.

    Readings are in the order of time. Stamps of odometry never decrease; scans keep their own
    stamps, at which the true pose is looked up.

    Raises:
        RecordingError: there is no scan.
    """

    path: Path
    readings: Sequence[Reading]
    skipped: tuple[SkippedLine, ...]

    def __post_init__(self) -> None:
        if not self.laser_count:
            what = f"{len(self.readings)} readings of odometry, {len(self.skipped)} bad lines"
            for line in self.skipped[:1]:
                what += f", first line {line.line_number}: {line.problem}"
            raise RecordingError(self.path, f"no scan in it: {what}")

    @property
    def laser_count(self) -> int:
        return sum(isinstance(reading, LaserReading) for reading in self.readings)


def open_recording(path: Path | str, settings: BridgeSettings) -> Recording:
    """Read a run log, a ROS bag, or a CARMEN log.

    The format is recognised by the content. The settings have the laser's mount, for a recording
    without it, and the topics and frames, for a bag with several.

    Raises:
        RecordingError: the file is missing, not a recording, has no scan, or is ambiguous.
            Malformed lines and a truncated end are skipped and listed instead; for a bag, a
            line is a message.
    """
    path = Path(path)
    try:
        is_read_once = path.exists() and not (path.is_file() or path.is_dir())
    except OSError as error:  # its folder may not be searched, or its name is too long
        raise RecordingError(path, os_problem(error)) from error
    if is_read_once:
        raise RecordingError(path, "is a pipe or a device; write it to a file, which is read twice")
    mount = (settings.laser_x_m, settings.laser_y_m, settings.laser_heading_rad)
    if is_run_log(path):
        entries, skipped = playback(path)
    elif is_bag(path):
        # Imported here, so that a live robot's bridge starts fast.
        from clustermcl.recordings.ros_bag import bag_entries  # noqa: PLC0415

        entries, skipped = bag_entries(path, settings)
    else:
        entries, skipped = carmen_entries(path, mount)
    entries, misplaced = plausible(entries)
    skipped += misplaced
    limit_m = range_limit_m(e.ranges.array() for _, e in entries if isinstance(e, LaserReading))
    limited = [
        replace(reading, range_max_m=min(limit_m, reading.range_max_m))
        if isinstance(reading, LaserReading)
        else reading
        for _, reading in entries
    ]
    skipped.sort(key=lambda line: line.line_number)
    return Recording(path, merged(limited), tuple(skipped))


def plausible(entries: Sequence[Entry]) -> tuple[list[Entry], list[SkippedLine]]:
    """Return entries, and those left out: with wrong stamps, or after the clock was set back.

    A stamp that is out of order with a neighbour is compared with the median of the five stamps
    around it. Stamps in ascending order are kept, however long the gaps.
    """
    stamps = np.array([reading.stamp_ns for _, reading in entries], np.int64)
    back = np.diff(stamps) < 0
    at, lost = np.flatnonzero(np.append(back, False) | np.insert(back, 0, False)), set[int]()
    if len(at):
        fives = sliding_window_view(stamps, min(5, len(stamps)))
        middle = np.median(fives[np.clip(at - 2, 0, len(fives) - 1)], axis=1)
        lost.update(at[np.abs(stamps[at] - middle) > MAX_DISORDER_NS].tolist())
    kept, skipped, latest_ns = list[Entry](), list[SkippedLine](), 0
    for number, entry in enumerate(entries):
        line, stamp_ns = entry.line_number, entry.reading.stamp_ns
        if number in lost:
            problem = f"its time {stamp_ns / 1e9:.6f} s is far from that of its neighbours"
            skipped.append(SkippedLine(line, problem))
            continue
        latest_ns = max(stamp_ns, latest_ns) if kept else stamp_ns
        if stamp_ns < latest_ns - MAX_DISORDER_NS:
            back_s = (latest_ns - stamp_ns) / 1e9
            problem = f"time steps back by {back_s:.0f} s; the rest of the recording is left out"
            skipped.append(SkippedLine(line, problem))
            break
        kept.append(entry)
    return kept, skipped


def merged(readings: Sequence[Reading]) -> list[Reading]:
    """Merge the readings of both sensors by time.

    A logger writes the messages of one sensor in the order of their arrival. Where stamps of a
    sensor decrease, the stamps are wrong, not the order: sorting the odometry of the Intel
    Research Lab log by its stamps turns a path of 508 m into 660 m. So each sensor keeps its order,
    and odometry has stamps that are corrected so that they never decrease.
    """
    is_laser = np.array([isinstance(reading, LaserReading) for reading in readings], bool)
    times = np.array([reading.stamp_ns for reading in readings], np.int64)
    for sensor in (is_laser, ~is_laser):
        times[sensor] = monotonic_times(times[sensor])
    order = np.argsort(times, kind="stable")
    return [
        one if is_laser[i] or one.stamp_ns == times[i] else replace(one, stamp_ns=int(times[i]))
        for i, one in ((i, readings[i]) for i in order.tolist())
    ]


def monotonic_times(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (n,) times that never decrease [ns]; stamps in ascending order are unchanged.

    Each time is the mean of the latest stamp before it and the earliest stamp after it.
    """
    latest_before = np.maximum.accumulate(stamps)
    earliest_after = np.minimum.accumulate(stamps[::-1])[::-1]
    return np.asarray(earliest_after + (latest_before - earliest_after) // 2, np.int64)


def range_limit_m(scans: Iterable[NDArray[np.float32]]) -> float:
    """Estimate the range from which on a reading means no return.

    Recordings mark a missing return by the longest range of their laser: 81.91, 81.83, 51.1 or
    50 m. No format has a field for it. Ranges above 99 % of the longest are taken as a marker if

    * they are at least 0.1 % of all ranges, and ten times as dense as those from 80 % of the
      longest range on,
    * at least half of them are the same number, unlike measured walls,
    * the longest range is at least 8 m, and twice the median of the others.

    Otherwise all ranges are measurements, and the limit is slightly more than the longest [m]. If
    this is wrong, only beams above 99 % are affected.
    """
    ranges = np.concatenate([np.empty(0, np.float32), *scans])
    ranges = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    if len(ranges) == 0:
        return SHORTEST_MARKER_M
    longest = float(ranges.max())
    limit = _BAND * longest
    band, others = ranges[ranges >= limit], ranges[ranges < limit]
    near = np.count_nonzero(others >= _NEAR_BAND * longest)
    usual = near * (1.0 - _BAND) / (_BAND - _NEAR_BAND)
    is_marked = (
        longest >= SHORTEST_MARKER_M
        and len(others) > 0
        and len(band) >= _MIN_SHARE * len(ranges)
        and len(band) >= _MIN_CONTRAST * usual
        and int(np.unique(band, return_counts=True)[1].max()) >= _MIN_MODE * len(band)
        and longest >= _MIN_REACH * float(np.median(others))
    )
    return limit if is_marked else longest * (2.0 - _BAND)
