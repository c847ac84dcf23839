"""Which range of a recording means that nothing came back."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

SHORTEST_MARKER_M = 8.0
"""Lasers that mark a lost beam by a long range write 8.18 m or more."""

_BAND = 0.99  # 81.83 and 81.91 m, or 51.10 to 51.16 m, are the same marker
_NEAR_BAND = 0.8
_MIN_SHARE = 0.001
_MIN_CONTRAST = 10.0
_MIN_MODE = 0.5
_MIN_REACH = 2.0


def range_limit_m(scans: Iterable[NDArray[np.float32]]) -> float:
    """From which range on a reading is no return, found in the recording itself.

    Recordings mark a lost beam by the longest range they know: 81.91, 81.83, 51.1 or 50 m, and
    none says so. The longest ranges, the uppermost hundredth, are taken for a marker if

    * they are a thousandth of all ranges or more, and ten times as frequent as ranges a little
      shorter (from 0.8 of the longest on),
    * half of them or more are one and the same number, which measured walls are not,
    * the longest is 8 m or more and twice the median of the others.

    Else every range is a measured one. A mistake costs the farthest hundredth of the beams.

    Args:
        scans: (B,) ranges of each scan [m].

    Returns:
        the limit [m]: a little more than the longest range where there is no marker.
    """
    ranges = np.concatenate([np.empty(0, np.float32), *scans])
    ranges = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    if len(ranges) == 0:
        return SHORTEST_MARKER_M
    longest = float(ranges.max())
    limit = _BAND * longest
    return limit if _is_marked(ranges, longest, limit) else longest * (2.0 - _BAND)


def _is_marked(ranges: NDArray[np.float32], longest: float, limit: float) -> bool:
    band, others = ranges[ranges >= limit], ranges[ranges < limit]
    if longest < SHORTEST_MARKER_M or len(others) == 0:
        return False
    near = np.count_nonzero(others >= _NEAR_BAND * longest)
    usual = near * (1.0 - _BAND) / (_BAND - _NEAR_BAND)
    most_frequent = int(np.unique(band, return_counts=True)[1].max())
    return bool(
        len(band) >= _MIN_SHARE * len(ranges)
        and len(band) >= _MIN_CONTRAST * usual
        and most_frequent >= _MIN_MODE * len(band)
        and longest >= _MIN_REACH * float(np.median(others))
    )
