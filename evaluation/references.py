"""Reference trajectories: where the robot really was, in the TUM format.

One pose a line, `timestamp x y z qx qy qz qw`, in seconds and metres; `#` begins a remark. Of the
orientation only the heading is used.
"""

import math
from bisect import bisect_left
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from particle_filter.arrays import Pose
from particle_filter.trajectory import bridgeable, interpolated
from protocol.errors import ReferenceFileError
from protocol.message import MAX_POSE_M, PoseTuple
from recordings.log_file import LogFile, numbers_of, stamp_ns_of

MAX_OUTSIDE_NS = 1_000_000_000
"""Before the first and after the last pose, that pose holds for so long [ns]."""

_WORDS = 8
_MAX_NORM_ERROR = 0.05


class Reference:
    """Poses at known times, and in between.

    Args:
        stamps_ns: times of the poses, in any order; of equal ones the first counts.
        map_from_robot: the poses.

    Raises:
        ValueError: no pose, or not as many times as poses.
    """

    def __init__(self, stamps_ns: Sequence[int], map_from_robot: Sequence[PoseTuple]) -> None:
        if len(stamps_ns) != len(map_from_robot) or not stamps_ns:
            raise ValueError(f"{len(stamps_ns)} times for {len(map_from_robot)} poses")
        order = sorted(range(len(stamps_ns)), key=stamps_ns.__getitem__)
        self._stamps = [stamps_ns[i] for i in order]
        self._poses = [map_from_robot[i] for i in order]

    def __len__(self) -> int:
        return len(self._stamps)

    def pose_at(self, stamp_ns: int) -> Pose | None:
        """The pose at a time.

        At the time of a pose it is exactly that pose, also where the stamps of the file step
        back. In between it is interpolated, the heading the short way round.

        Returns:
            (3,) x [m], y [m], heading [rad]; None where nobody knows: more than 1 s before the
            first or after the last pose, or in a gap of more than 2 s across which the robot
            moved by more than 1 m or 1 rad. Where it stood, the gap may be of any length.
        """
        pose = self._pose_at(stamp_ns)
        return None if pose is None else np.array(pose)

    def _pose_at(self, stamp_ns: int) -> PoseTuple | None:
        stamps, poses = self._stamps, self._poses
        after = bisect_left(stamps, stamp_ns)
        if after < len(stamps) and stamps[after] == stamp_ns:
            return poses[after]
        if after in (0, len(stamps)):
            end = min(after, len(stamps) - 1)
            return poses[end] if abs(stamps[end] - stamp_ns) <= MAX_OUTSIDE_NS else None
        before = after - 1
        if not bridgeable(stamps[before], poses[before], stamps[after], poses[after]):
            return None
        share = (stamp_ns - stamps[before]) / (stamps[after] - stamps[before])
        return interpolated(poses[before], poses[after], share)


def load_reference(path: Path | str) -> Reference:
    """Read a reference trajectory; gzip and xz are unpacked.

    Raises:
        ReferenceFileError: with the line: the file is missing, cut off, holds no pose, or a line
            is not of the format. A reference with holes would judge wrongly, so none is skipped.
    """
    path = Path(path)
    log = LogFile(path, ReferenceFileError)
    stamps_ns: list[int] = []
    poses: list[PoseTuple] = []
    for number, line in log.lines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            stamp_ns, pose = _parsed(words)
        except ValueError as problem:
            raise ReferenceFileError(path, str(problem), line=number) from None
        stamps_ns.append(stamp_ns)
        poses.append(pose)
    if log.broken:
        raise ReferenceFileError(path, log.broken.problem, line=log.broken.line_number)
    if not poses:
        raise ReferenceFileError(path, "no pose in it; expected lines of the TUM format")
    return Reference(stamps_ns, poses)


def _parsed(words: Sequence[str]) -> tuple[int, PoseTuple]:
    """Stamp [ns] and pose of one line."""
    if len(words) != _WORDS:
        raise ValueError(f"{len(words)} numbers, a TUM line has {_WORDS}: t x y z qx qy qz qw")
    x, y, z, *quaternion = numbers_of(words[1:])
    if not max(abs(x), abs(y), abs(z)) < MAX_POSE_M:
        raise ValueError(f"({' '.join(words[1:4])}) is no place")
    return stamp_ns_of(words[0]), (x, y, _heading(*quaternion))


def _heading(qx: float, qy: float, qz: float, qw: float) -> float:
    """Heading of a unit quaternion: the direction of the robot's x axis seen from above [rad]."""
    norm = math.sqrt(qx * qx + qy * qy + qz * qz + qw * qw)
    if not abs(norm - 1.0) <= _MAX_NORM_ERROR:
        raise ValueError(f"the orientation is no unit quaternion: its length is {norm:.3g}")
    return math.atan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
