"""Reads ground truth in the TUM format, and writes estimates in it.

One pose a line, `timestamp x y z qx qy qz qw`, in seconds and metres; `#` begins a comment. Only
the heading is used of the orientation. evo and the TUM RGB-D benchmark's tools read the same.
"""

import math
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

from clustermcl.filter.motion.trajectory import Trajectory
from clustermcl.protocol.errors import ReferenceFileError
from clustermcl.protocol.message import MAX_POSE_M, PoseTuple
from clustermcl.recordings.log_file import SkippedLine, stamp_ns_of, words_of_lines

MAX_OUTSIDE_NS = 1_000_000_000
"""Time for which the first pose holds before it, and the last after it [ns]."""

_WORDS = 8
_MAX_NORM_ERROR = 0.05


def load_reference(path: Path | str) -> Trajectory:
    """Read a reference trajectory; gzip and xz are unpacked.

    Raises:
        ReferenceFileError: with the line: the file is missing, cut off, holds no pose, or a line
            has another format. No line is skipped, because a gap would distort the measures.
    """
    path = Path(path)
    broken: list[SkippedLine] = []
    poses: list[tuple[int, PoseTuple]] = []
    for number, words in words_of_lines(path, broken, ReferenceFileError):
        try:
            poses.append(_parsed(words))
        except ValueError as problem:
            raise ReferenceFileError(path, str(problem), line=number) from None
    for line in broken:
        raise ReferenceFileError(path, line.problem, line=line.line_number)
    if not poses:
        raise ReferenceFileError(path, "no pose in it; expected lines of the TUM format")
    reference = Trajectory(held_ns=MAX_OUTSIDE_NS)
    for stamp_ns, pose in sorted(poses, key=itemgetter(0)):  # stamps may step back
        reference.add(stamp_ns, pose)
    return reference


def tum_line(stamp_ns: int, pose: PoseTuple) -> str:
    x, y, heading = pose
    turn = f"{math.sin(heading / 2.0):.9f} {math.cos(heading / 2.0):.9f}"
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {x:.6f} {y:.6f} 0 0 0 {turn}\n"


def _parsed(words: Sequence[str]) -> tuple[int, PoseTuple]:
    if len(words) != _WORDS:
        raise ValueError(f"{len(words)} numbers, a TUM line has {_WORDS}: t x y z qx qy qz qw")
    x, y, z, *quaternion = map(float, words[1:])
    if not math.hypot(x, y, z) < MAX_POSE_M:
        raise ValueError(f"({' '.join(words[1:4])}) is not a position")
    return stamp_ns_of(words[0]), (x, y, _heading(*quaternion))


def _heading(qx: float, qy: float, qz: float, qw: float) -> float:
    """Return the direction of the robot's x axis seen from above [rad], of a unit quaternion."""
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if not abs(norm - 1.0) <= _MAX_NORM_ERROR:
        raise ValueError(f"the orientation is not a unit quaternion: its length is {norm:.3g}")
    return math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
