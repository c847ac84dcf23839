"""Recordings of CMU's Wean Hall, as robotics courses hand them out.

    O x y theta ts                            odometry
    L x y theta xl yl thetal r1 .. r180 ts    scan: pose of the robot, of the laser, 180 ranges

Centimetres, radians, seconds. Beams run counter-clockwise from -90 degrees, one a degree: the
last looks to +89. The poses of an `L` line are the odometry at the time of the scan.
"""

import math
from collections.abc import Sequence

from recordings.laser_mount import mounting
from recordings.log_file import (
    Entry,
    LaserEntry,
    OdometryEntry,
    pose_of,
    ranges_of,
    stamp_ns_of,
)

BEAMS = 180

_M_PER_CM = 0.01
_ODOMETRY_WORDS, _LASER_WORDS = 5, 7 + BEAMS + 1


def is_wean_line(words: Sequence[str]) -> bool:
    """Whether a line begins as those of this format do."""
    return words[0] in ("O", "L") and len(words) > 1


class WeanParser:
    """Reads line after line; each stands for itself."""

    def parse(self, line_number: int, words: Sequence[str]) -> Entry | None:
        """Read one line; see `LogParser`."""
        match words[0]:
            case "O":
                _check_count(words, _ODOMETRY_WORDS)
                odom_from_robot = pose_of(words[1:4], _M_PER_CM)
                return OdometryEntry(line_number, stamp_ns_of(words[4]), odom_from_robot)
            case "L":
                _check_count(words, _LASER_WORDS)
                return _laser(line_number, words)
        raise ValueError(f"unknown kind of line {words[0]!r:.20}")

    def finished(self, entries: Sequence[Entry]) -> list[Entry]:
        """The entries as they are."""
        return list(entries)


def _laser(line_number: int, words: Sequence[str]) -> LaserEntry:
    odom_from_robot = pose_of(words[1:4], _M_PER_CM)
    return LaserEntry(
        line_number=line_number,
        stamp_ns=stamp_ns_of(words[-1]),
        ranges=ranges_of(words[7:-1], _M_PER_CM),
        angle_min_rad=-math.pi / 2,
        angle_step_rad=math.radians(1.0),
        robot_from_laser=mounting(odom_from_robot, pose_of(words[4:7], _M_PER_CM)),
        odom_from_robot=odom_from_robot,
    )


def _check_count(words: Sequence[str], expected: int) -> None:
    if len(words) != expected:
        raise ValueError(f"{len(words) - 1} numbers, a {words[0]} line has {expected - 1}")
