"""Parser of CARMEN logs, the text recordings of many public data sets."""

import math
from array import array
from collections.abc import Sequence

from msgspec.structs import replace

from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import MAX_BEAMS, LaserReading, OdometryReading
from clustermcl.recordings.laser_mount import fixed_mounting, mounting
from clustermcl.recordings.log_file import (
    SENDER,
    Entry,
    numbers_of,
    pose_of,
    ranges_of,
    stamp_ns_of,
)

READ_KINDS = frozenset({"PARAM", "ODOM", "FLASER", "RAWLASER1", "ROBOTLASER1"})
OTHER_KINDS = frozenset(
    {"SYNC", "TRUEPOS", "MARKER", "POSITION", "VELOCITY", "BASEPOSITION", "ARM", "PANTILT"}
    | {"RLASER", "LASER3", "LASER4", "REMISSIONFLASER", "REMISSIONRLASER", "POSITIONLASER"}
    | {"RAWLASER2", "RAWLASER3", "RAWLASER4", "RAWLASER5", "ROBOTLASER2", "SCANMARK"}
    | {"NMEAGGA", "NMEARMC", "SONAR", "BUMPER", "IMU"}
)

_OFFSET, _SIDE_OFFSET, _ANGULAR_OFFSET = (
    "robot_frontlaser_offset",
    "robot_frontlaser_side_offset",
    "robot_frontlaser_angular_offset",
)
_RESOLUTION_DEG = "laser_front_laser_resolution"
_PARAMETERS = (_OFFSET, _SIDE_OFFSET, _ANGULAR_OFFSET, _RESOLUTION_DEG)
_SICK = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5, 400: 0.25, 401: 0.25, 200: 0.5, 201: 0.5}
"""Angular step [degrees] by number of beams, for SICK's lasers of 180 and 100 degrees."""
_COMMON_STEPS_DEG = (1.0, 0.5, 0.25)

_TAIL = 3  # ts host logger_ts
_CONFIG = 8  # kind type start fov step max accuracy remission


def is_carmen_line(words: Sequence[str]) -> bool:
    return words[0] in READ_KINDS or words[0] in OTHER_KINDS


class CarmenParser:
    """Parser of CARMEN logs; parameters apply to the lines below them:

        PARAM name value ...
        ODOM x y theta tv rv accel ts host logger_ts
        FLASER n r1 .. rn x y theta odom_x odom_y odom_theta ts host logger_ts
        RAWLASER1 type start fov step max accuracy remission n r1 .. rn m q1 .. qm ts host logger_ts
        ROBOTLASER1 (as RAWLASER1 up to qm) laser's x y theta, robot's x y theta,
                    tv rv forward_safety side_safety turn_axis ts host logger_ts

    Metres, radians, seconds; beams run counter-clockwise. `ROBOTLASER1` is the successor of
    `FLASER`. If a recording has `RAWLASER1` lines next to either, they repeat the same scans, and
    are skipped. Other messages (rear lasers, GPS, remarks) are skipped, too. `mount` is the laser's
    pose on the robot for a log that lacks it.
    """

    def __init__(self, mount: PoseTuple) -> None:
        self._default_mount = mount
        self._unmounted: set[int] = set()
        self._parameters: dict[str, float] = {}
        self._logged_ns = array("q")
        self._raw_lines: set[int] = set()
        self._pose_pairs: list[tuple[PoseTuple, PoseTuple]] = []

    def parse(self, line_number: int, words: Sequence[str]) -> Entry | None:
        match words[0]:
            case "PARAM":
                if len(words) >= 3 and words[1] in _PARAMETERS:
                    self._parameters[words[1]] = numbers_of(words[2:3])[0]
                return None
            case "ODOM":
                _check_count(words, 1 + 6 + _TAIL)
                pose, stamp_ns = pose_of(words[1:4]), stamp_ns_of(words[-3])
                entry = Entry(
                    line_number,
                    OdometryReading(sender=SENDER, stamp_ns=stamp_ns, odom_from_robot=pose),
                )
            case "FLASER":
                entry = Entry(line_number, self._flaser(line_number, words))
            case "RAWLASER1" | "ROBOTLASER1":
                entry = Entry(line_number, self._configured_laser(line_number, words))
            case kind if kind in OTHER_KINDS:
                return None
            case kind:
                raise ValueError(f"unknown kind of line {kind!r:.20}")
        self._logged_ns.append(stamp_ns_of(words[-1]))
        return entry

    def finished(self, entries: Sequence[Entry]) -> list[Entry]:
        """Remove repeated scans, add the laser's mount, and choose the better clock.

        Args:
            entries: all that `parse` has returned, in that order.
        """
        # Times since 1970 that were written with six digits are all the same.
        if len({reading.stamp_ns for _, reading in entries}) == 1 < len(set(self._logged_ns)):
            entries = [
                Entry(line, replace(reading, stamp_ns=logged))
                for (line, reading), logged in zip(entries, self._logged_ns, strict=True)
            ]
        lasers = {line for line, reading in entries if isinstance(reading, LaserReading)}
        if lasers - self._raw_lines:
            entries = [entry for entry in entries if entry.line_number not in self._raw_lines]
        if (mount := fixed_mounting(self._pose_pairs)) is None:
            return list(entries)
        return [
            Entry(line, replace(reading, robot_from_laser=mount))
            if line in self._unmounted
            else entry
            for entry in entries
            for line, reading in (entry,)
        ]

    def _mount(self, line_number: int) -> PoseTuple:
        """Return the laser's mount from the parameters, or else the default."""
        if _OFFSET not in self._parameters:
            self._unmounted.add(line_number)
            return self._default_mount
        get = self._parameters.get
        return get(_OFFSET, 0.0), get(_SIDE_OFFSET, 0.0), get(_ANGULAR_OFFSET, 0.0)

    def _flaser(self, line_number: int, words: Sequence[str]) -> LaserReading:
        beams = _beam_count(words, 1)
        _check_count(words, 2 + beams + 6 + _TAIL)
        angle_min_rad, angle_step_rad = flaser_angles(beams, self._parameters.get(_RESOLUTION_DEG))
        odom_from_robot = pose_of(words[beams + 5 : beams + 8])
        mount = self._mount(line_number)
        if line_number in self._unmounted:
            # CARMEN writes the laser's pose first. Many public logs have a corrected pose of the
            # robot there, which drifts from odometry and is unrelated to the laser.
            self._pose_pairs.append((odom_from_robot, pose_of(words[beams + 2 : beams + 5])))
        return LaserReading(
            sender=SENDER,
            stamp_ns=stamp_ns_of(words[-3]),
            ranges=ranges_of(words[2 : beams + 2]),
            range_max_m=math.inf,
            angle_min_rad=angle_min_rad,
            angle_step_rad=angle_step_rad,
            robot_from_laser=mount,
            odom_from_robot=odom_from_robot,
        )

    def _configured_laser(self, line_number: int, words: Sequence[str]) -> LaserReading:
        beams = _beam_count(words, _CONFIG)
        remissions_at = _CONFIG + 1 + beams
        poses_at = remissions_at + 1 + _beam_count(words, remissions_at, least=0)
        raw = words[0] == "RAWLASER1"
        # The last of eleven numbers, the turn axis, is missing in older logs.
        _check_count(words, *(poses_at + more + _TAIL for more in ((0,) if raw else (11, 10))))
        start, _, step, limit = numbers_of(words[2:6])
        if not (math.isfinite(start) and 0.0 < step * (beams - 1 or 1) < 1.01 * math.tau):
            raise ValueError(f"beams from {start} rad, {step} rad apart: no scan")
        odom_from_robot: PoseTuple | None = None
        if raw:
            mount = self._mount(line_number)
            self._raw_lines.add(line_number)
        else:
            odom_from_robot = pose_of(words[poses_at + 3 : poses_at + 6])
            mount = mounting(odom_from_robot, pose_of(words[poses_at : poses_at + 3]))
        return LaserReading(
            sender=SENDER,
            stamp_ns=stamp_ns_of(words[-3]),
            ranges=ranges_of(words[_CONFIG + 1 : remissions_at]),
            angle_min_rad=start,
            angle_step_rad=step,
            robot_from_laser=mount,
            odom_from_robot=odom_from_robot,
            range_max_m=limit if limit > 0.0 else math.inf,
        )


def _beam_count(words: Sequence[str], at: int, least: int = 1) -> int:
    try:
        count = int(words[at])
    except (IndexError, ValueError):
        raise ValueError(f"a {words[0]} line without its number of readings") from None
    if not least <= count <= len(words) - at:
        raise ValueError(f"{count} readings announced, the line has {len(words)} words")
    if count > MAX_BEAMS:
        raise ValueError(f"{count} readings; at most {MAX_BEAMS} are read")
    return count


def _check_count(words: Sequence[str], *expected: int) -> None:
    if len(words) not in expected:
        raise ValueError(f"{len(words)} words, this {words[0]} line needs {expected[0]}")


def flaser_angles(beams: int, step_deg: float | None = None) -> tuple[float, float]:
    """Return the direction of the first beam and the step between beams [rad].

    The field of view is centred straight ahead. With an even number of beams the last one is
    missing, as with SICK's lasers and CARMEN: 181 beams reach from -90 to +90 degrees, 180 beams
    from -90 to +89. The step is the first that applies:

    1. that of SICK's lasers with this number of beams (CARMEN's own table),
    2. `step_deg`, the log's parameter `laser_front_laser_resolution`,
    3. the largest of 1, 0.5 and 0.25 degrees with a field of view of 180 to 270 degrees:
       541 beams are 270 degrees, 761 are 190,
    4. the one that spreads the beams over 180 degrees, as in CARMEN.
    """
    steps = beams if beams % 2 == 0 else max(beams - 1, 1)
    given = step_deg if step_deg is not None and 0.0 < step_deg * steps <= 360.0 else None
    usual = (step for step in _COMMON_STEPS_DEG if 180.0 <= step * steps <= 270.0)
    step_deg = _SICK.get(beams) or given or next(usual, None) or 180.0 / steps
    return -math.radians(step_deg * steps / 2.0), math.radians(step_deg)
