"""What makes a reading, or a scan made of one, useless before anything is computed from it."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from protocol.errors import MalformedMessageError
from protocol.message import MAX_POSE_M, PoseTuple
from protocol.steps import LaserReading, OdometryReading, Scan

MAX_BEAMS = 20_000
"""No laser of today gives more; a larger scan is a mistake."""

MALFORMED = "malformed"
NOT_FINITE = "not_finite"
BAD_GEOMETRY = "bad_geometry"
NO_BEAMS = "no_beams"
TOO_MANY_BEAMS = "too_many_beams"
NO_RETURNS = "no_returns"

_MAX_STAMP_NS = 2**62
_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def odometry_problem(reading: OdometryReading) -> str | None:
    """Why an odometry reading cannot be used; None if it can."""
    return pose_problem(reading.odom_from_robot) or stamp_problem(reading.stamp_ns)


def laser_problem(reading: LaserReading | Scan) -> str | None:
    """Why a scan cannot be used; None if it can."""
    poses = (reading.robot_from_laser, reading.odom_from_robot or reading.robot_from_laser)
    for problem in (stamp_problem(reading.stamp_ns), *map(pose_problem, poses)):
        if problem:
            return problem
    try:
        ranges = reading.ranges.array()
    except MalformedMessageError:
        return MALFORMED
    return _geometry_problem(reading, ranges.shape) or _ranges_problem(ranges, reading.range_max_m)


def stamp_problem(stamp_ns: int) -> str | None:
    """Why this is no time of a robot's clock; None if it is."""
    return None if abs(stamp_ns) < _MAX_STAMP_NS else NOT_FINITE


def pose_problem(pose: PoseTuple) -> str | None:
    """Why this cannot be a pose: not finite, or no place on Earth; None if it can."""
    usable = max(abs(pose[0]), abs(pose[1])) < MAX_POSE_M and math.isfinite(sum(pose))
    return None if usable else NOT_FINITE


def _geometry_problem(reading: LaserReading | Scan, shape: Sequence[int]) -> str | None:
    if len(shape) != 1:
        return MALFORMED
    beams = shape[0]
    if beams == 0:
        return NO_BEAMS
    if beams > MAX_BEAMS:
        return TOO_MANY_BEAMS
    if not (math.isfinite(reading.angle_min_rad) and math.isfinite(reading.angle_step_rad)):
        return NOT_FINITE
    field_rad = abs(reading.angle_step_rad) * (beams - 1)
    if (beams > 1 and field_rad == 0.0) or field_rad > 1.01 * math.tau:
        return BAD_GEOMETRY
    return None


def _ranges_problem(ranges: NDArray[np.floating], range_max_m: float) -> str | None:
    if math.isnan(range_max_m):
        return NOT_FINITE
    if ranges.dtype == np.float32 and abs(range_max_m) > _LARGEST_FLOAT32:
        range_max_m = math.copysign(math.inf, range_max_m)  # what it would be as a float32
    returned = (ranges > 0.0) & (ranges < range_max_m)  # what is not finite is not below it
    return None if returned.any() else NO_RETURNS
