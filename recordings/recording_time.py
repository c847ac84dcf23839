"""The order of a recording's lines: stamps err more often than loggers do.

A logger writes the messages of one sensor in the order in which they came. Where stamps of one
sensor step back, they err, not the order: on the Intel Research Lab log, sorting odometry by its
stamps makes 660 m of a path of 508 m. So each sensor keeps its order, and only the two of them
are merged by time.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recordings.log_file import Entry, LaserEntry, SkippedLine

MAX_DISORDER_NS = 10_000_000_000
"""Stamps may be wrong by so much [ns] and still be in the same recording."""


def plausible(entries: Sequence[Entry]) -> tuple[list[Entry], list[SkippedLine]]:
    """Leave out lines whose time cannot be, and all that follows a second start of the clock.

    A stamp that is out of order with a neighbour is compared with the middle one of the five
    stamps around it. Stamps in their order are never refused, however long the gaps.
    """
    stamps = np.array([entry.stamp_ns for entry in entries], np.int64)
    lost = _out_of_order(stamps) & (np.abs(stamps - _middle_of_five(stamps)) > MAX_DISORDER_NS)
    kept: list[Entry] = []
    skipped: list[SkippedLine] = []
    latest = None
    for entry, is_lost in zip(entries, lost, strict=True):
        if is_lost:
            problem = f"its time {entry.stamp_ns / 1e9:.6f} s is far from that of its neighbours"
            skipped.append(SkippedLine(entry.line_number, problem))
            continue
        if latest is not None and entry.stamp_ns < latest - MAX_DISORDER_NS:
            back_s = (latest - entry.stamp_ns) / 1e9
            problem = f"time steps back by {back_s:.0f} s; from here on the recording is left out"
            skipped.append(SkippedLine(entry.line_number, problem))
            break
        latest = entry.stamp_ns if latest is None else max(latest, entry.stamp_ns)
        kept.append(entry)
    return kept, skipped


def merged(entries: Sequence[Entry]) -> tuple[list[Entry], list[int]]:
    """Entries in the order in which they happened, and the time of each.

    Returns:
        the entries, and times that never decrease within one sensor [ns]: the stamps, mended
        where they step back.
    """
    is_laser = np.array([isinstance(entry, LaserEntry) for entry in entries], bool)
    times = np.array([entry.stamp_ns for entry in entries], np.int64)
    for sensor in (is_laser, ~is_laser):
        times[sensor] = mended(times[sensor])
    order = np.argsort(times, kind="stable")
    return [entries[i] for i in order], [int(times[i]) for i in order]


def mended(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) times that never decrease; stamps that already do not come back unchanged.

    Each is half way between the latest stamp so far and the earliest still to come.
    """
    if len(stamps) == 0:
        return stamps
    latest_before = np.maximum.accumulate(stamps)
    earliest_after = np.minimum.accumulate(stamps[::-1])[::-1]
    return np.asarray(earliest_after + (latest_before - earliest_after) // 2, np.int64)


def _out_of_order(stamps: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(n,) whether a stamp is above the one after it or below the one before it."""
    steps_back = np.diff(stamps) < 0
    return np.asarray(np.append(steps_back, False) | np.insert(steps_back, 0, False), np.bool_)


def _middle_of_five(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) medians over the stamp and its two neighbours on both sides; the ends share theirs."""
    if len(stamps) < 5:
        return np.full(len(stamps), np.median(stamps) if len(stamps) else 0, np.int64)
    windows = np.lib.stride_tricks.sliding_window_view(stamps, 5)
    middles = np.sort(windows, axis=1)[:, 2]
    return np.pad(middles, 2, mode="edge")
