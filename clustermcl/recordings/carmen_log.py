"""Reads CARMEN logs, the text recordings of many public data sets."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clustermcl.filter.poses import between
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.errors import RecordingError
from clustermcl.protocol.message import MAX_POSE_M, PoseTuple
from clustermcl.protocol.steps import MAX_BEAMS, LaserReading, OdometryReading, Reading
from clustermcl.recordings.log_file import SENDER, Entry, SkippedLine, stamp_ns_of, words_of_lines
from clustermcl.recordings.rigid import MAX_MOUNT_M

_KINDS = ("PARAM", "ODOM", "FLASER", "ROBOTLASER1")
_OFFSETS = (
    "robot_frontlaser_offset",
    "robot_frontlaser_side_offset",
    "robot_frontlaser_angular_offset",
)
_SICK = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25, 200: 0.5, 201: 0.5}
"""Angular step [degrees] by number of beams, for SICK's lasers of 180 and 100 degrees."""
_COMMON_STEPS_DEG = (1.0, 0.5, 0.25)

_TAIL = 3  # ts host logger_ts
_CONFIG = 8  # kind type start fov step max accuracy remission
_FORMAT_LINES, _MAX_BAD_LINES = 1000, 1_000_000
"""Bad lines after which a file is no log, and after which a log is refused."""


def carmen_entries(path: Path, mount: PoseTuple) -> tuple[list[Entry], list[SkippedLine]]:
    """Return the entries of a CARMEN log in the order of its lines, and the skipped lines.

        PARAM name value ...
        ODOM x y theta tv rv accel ts host logger_ts
        FLASER n r1 .. rn x y theta odom_x odom_y odom_theta ts host logger_ts
        ROBOTLASER1 type start fov step max accuracy remission n r1 .. rn m q1 .. qm
                    laser's x y theta, robot's x y theta,
                    tv rv forward_safety side_safety turn_axis ts host logger_ts

    Metres, radians, seconds; beams run counter-clockwise; parameters apply to the lines below them.
    `ROBOTLASER1` is the successor of `FLASER`. Other messages (rear lasers, raw scans, GPS) begin
    with other words in upper case and are skipped. `mount` is that of a log that lacks it.

    Raises:
        RecordingError: the file cannot be read, or has no such line.
    """
    entries, skipped, broken = list[Entry](), list[SkippedLine](), list[SkippedLine]()
    offsets, is_known = dict[str, float](), False
    for number, words in words_of_lines(path, broken):
        is_known = is_known or words[0] in _KINDS
        try:
            reading = _parsed(words, offsets, mount)
        except ValueError as problem:
            skipped.append(SkippedLine(number, str(problem)))
            if not is_known and len(skipped) >= _FORMAT_LINES:
                break
            if len(skipped) > _MAX_BAD_LINES:
                raise RecordingError(path, f"more than {_MAX_BAD_LINES} bad lines") from None
        else:
            entries += [Entry(number, reading)] if reading else []
    if not is_known:
        what = "empty, or not a recording: no line of a CARMEN log (ODOM, FLASER ...)"
        raise RecordingError(path, broken[0].problem if broken else what)
    return entries, skipped + broken


def _parsed(words: Sequence[str], offsets: dict[str, float], mount: PoseTuple) -> Reading | None:
    """Return the reading of a line, if it has one; add its parameter to those of the mount."""
    match words[0]:
        case "PARAM":
            if len(words) >= 3 and words[1] in _OFFSETS:
                offsets[words[1]] = float(words[2])
            return None
        case "ODOM":
            _check_count(words, 1 + 6 + _TAIL)
            pose, stamp_ns = _pose_of(words[1:4]), stamp_ns_of(words[-3])
            return OdometryReading(sender=SENDER, stamp_ns=stamp_ns, odom_from_robot=pose)
        case "FLASER":
            if _OFFSETS[0] in offsets:
                x, y, heading = (offsets.get(name, 0.0) for name in _OFFSETS)
                mount = x, y, heading
            return _flaser(words, mount)
        case "ROBOTLASER1":
            return _robot_laser(words)
        case kind if kind.isupper():
            return None
        case kind:
            raise ValueError(f"unknown kind of line {kind!r:.20}")


def _flaser(words: Sequence[str], mount: PoseTuple) -> LaserReading:
    beams = _beam_count(words, 1)
    _check_count(words, 2 + beams + 6 + _TAIL)
    angle_min_rad, angle_step_rad = flaser_angles(beams)
    return LaserReading(
        sender=SENDER,
        stamp_ns=stamp_ns_of(words[-3]),
        ranges=_ranges_of(words[2 : beams + 2]),
        range_max_m=math.inf,
        angle_min_rad=angle_min_rad,
        angle_step_rad=angle_step_rad,
        robot_from_laser=mount,
        # Before it, many public logs have a corrected pose, unrelated to the laser's.
        odom_from_robot=_pose_of(words[beams + 5 : beams + 8]),
    )


def _robot_laser(words: Sequence[str]) -> LaserReading:
    beams = _beam_count(words, _CONFIG)
    remissions_at = _CONFIG + 1 + beams
    poses_at = remissions_at + 1 + _beam_count(words, remissions_at, least=0)
    # The last of eleven numbers, the turn axis, is missing in older logs.
    _check_count(words, poses_at + 11 + _TAIL, poses_at + 10 + _TAIL)
    start, _, step, limit = map(float, words[2:6])
    if not (math.isfinite(start) and 0.0 < step * (beams - 1 or 1) < 1.01 * math.tau):
        raise ValueError(f"beams from {start} rad, {step} rad apart: no scan")
    laser, robot = _pose_of(words[poses_at : poses_at + 3]), _pose_of(words[poses_at + 3 :][:3])
    x, y, heading = between(np.array(robot), np.array(laser)).tolist()
    if math.hypot(x, y) > MAX_MOUNT_M:
        raise ValueError(f"the laser is {math.hypot(x, y):.0f} m from the robot")
    return LaserReading(
        sender=SENDER,
        stamp_ns=stamp_ns_of(words[-3]),
        ranges=_ranges_of(words[_CONFIG + 1 : remissions_at]),
        angle_min_rad=start,
        angle_step_rad=step,
        # Logs resolve 0.1 mm; 0.0 is added against -0.0.
        robot_from_laser=(round(x, 4) + 0.0, round(y, 4) + 0.0, round(heading, 5) + 0.0),
        odom_from_robot=robot,
        range_max_m=limit if limit > 0.0 else math.inf,
    )


def _pose_of(words: Sequence[str]) -> PoseTuple:
    x, y, heading = map(float, words)
    if not (abs(x) < MAX_POSE_M and abs(y) < MAX_POSE_M and math.isfinite(heading)):
        raise ValueError(f"({' '.join(words)}) is not a pose")
    return x, y, math.remainder(heading, math.tau)


def _ranges_of(words: Sequence[str]) -> ArrayBlob:
    with np.errstate(over="ignore"):  # 1e300 m becomes infinite: no return
        return ArrayBlob.of(np.array(list(map(float, words))).astype(np.float32), "float32")


def _beam_count(words: Sequence[str], at: int, least: int = 1) -> int:
    try:
        count = int(words[at])
    except (IndexError, ValueError):
        raise ValueError(f"a {words[0]} line without its number of readings") from None
    if not least <= count <= min(len(words) - at, MAX_BEAMS):
        what = f"{count} readings announced, at most {MAX_BEAMS} are read"
        raise ValueError(f"{what}; the line has {len(words)} words")
    return count


def _check_count(words: Sequence[str], *expected: int) -> None:
    if len(words) not in expected:
        raise ValueError(f"{len(words)} words, this {words[0]} line needs {expected[0]}")


def flaser_angles(beams: int) -> tuple[float, float]:
    """Return the direction of the first beam and the step between beams [rad].

    The field of view is centred straight ahead. With an even number of beams the last one is
    missing, as with SICK's lasers and CARMEN: 181 beams reach from -90 to +90 degrees, 180 beams
    from -90 to +89. The step is the first that applies:

    1. that of SICK's lasers with this number of beams (CARMEN's own table),
    2. the largest of 1, 0.5 and 0.25 degrees with a field of view of 180 to 270 degrees:
       541 beams are 270 degrees, 761 are 190,
    3. the one that spreads the beams over 180 degrees, as in CARMEN.
    """
    steps = beams if beams % 2 == 0 else max(beams - 1, 1)
    usual = (step for step in _COMMON_STEPS_DEG if 180.0 <= step * steps <= 270.0)
    step_deg = _SICK.get(beams) or next(usual, None) or 180.0 / steps
    return -math.radians(step_deg * steps / 2.0), math.radians(step_deg)
