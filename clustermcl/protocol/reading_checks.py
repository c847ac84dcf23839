"""Check readings and scans before anything is computed from them."""

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clustermcl.protocol import steps
from clustermcl.protocol.causes import Cause, key_of
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import MAX_POSE_M, PoseTuple

MAX_LASERS = 16
"""Lasers of one robot."""
MAX_LASER_NAME = 128
"""Characters of a laser's name."""
MIN_VARIANCE = 1e-8
"""Least variance of an observation: a standard deviation of 0.1 mm or mrad."""

_Laser: TypeAlias = steps.LaserReading | steps.Scan | steps.LaserBeams
_SOME = 8
_MAX_STAMP_NS = 2**62
_LARGEST_FLOAT32 = float(np.finfo(np.float32).max)


def scan_problem(scan: steps.Scan) -> str | None:
    """Return the defect that makes a step unusable, or None."""
    problem = stamp_problem(scan.stamp_ns) or pose_problem(scan.odom_from_robot)
    if len(scan.others) >= MAX_LASERS:
        problem = problem or Cause.MALFORMED
    lasers: list[_Laser] = [scan, *scan.others]
    if problem := problem or next(filter(None, map(beams_problem, lasers)), None):
        return key_of(problem)
    names = {"", *(landmark.name for landmark in scan.landmarks)}
    if any(seen.landmark not in names for seen in scan.observations):
        return "a landmark that is not on the map"
    return next(filter(None, map(observation_problem, scan.observations)), None)


def laser_problem(reading: steps.LaserReading) -> Cause | None:
    """Return the defect that makes a scan unusable, or None."""
    odom_from_robot = reading.odom_from_robot or reading.robot_from_laser
    if problem := stamp_problem(reading.stamp_ns) or pose_problem(odom_from_robot):
        return problem
    if math.isnan(reading.range_min_m):
        return Cause.NOT_FINITE
    if len(reading.laser) > MAX_LASER_NAME:
        return Cause.MALFORMED
    return beams_problem(reading, reading.range_min_m)


def numbers_of(reading: steps.OdometryReading | steps.LaserReading, problem: Cause) -> str:
    """Return the numbers of an unusable reading, from which its defect can be seen."""
    pose = reading.odom_from_robot
    numbers = f"stamp {reading.stamp_ns / 1e9:.3f} s" + (f", odometry {pose}" if pose else "")
    if isinstance(reading, steps.OdometryReading):
        return numbers
    count, step = math.prod(reading.ranges.shape), reading.angle_step_rad
    in_degrees = problem == Cause.BAD_GEOMETRY and 0.0 < abs(step) * (count - 1) <= 364.0
    return (
        f"{count} beams, angle step {step:.4g} rad{' (degrees?)' if in_degrees else ''}, ranges of "
        f"{reading.range_min_m:.4g} to {reading.range_max_m:.4g} m, {numbers}"
    )


def beams_problem(laser: _Laser, range_min_m: float = 0.0) -> Cause | None:
    """Return the defect that makes one laser's measurement unusable, or None."""
    if problem := pose_problem(laser.robot_from_laser):
        return problem
    try:
        ranges = laser.ranges.array()
    except MalformedMessageError:
        return Cause.MALFORMED
    return _geometry_problem(laser, ranges.shape) or _ranges_problem(
        ranges, range_min_m, laser.range_max_m
    )


def observation_problem(seen: steps.Observation | steps.Seen) -> str | None:
    """Return why an observation is impossible, or None."""
    size = len(seen.mean)
    if size > (2 if seen.landmark else 3) or len(seen.covariance) != size**2:
        return f"{size} numbers with a covariance of {len(seen.covariance)}"
    if max(map(abs, seen.mean)) > MAX_POSE_M:
        return "an observation out of range"
    if seen.field is not None and (problem := _field_problem(seen, seen.field)):
        return problem
    return covariance_problem(seen.covariance, MIN_VARIANCE, 1e-12)


def covariance_problem(covariance: Sequence[float], least: float, share: float) -> str | None:
    """Return why a matrix, row by row, is not a covariance, or None.

    Its eigenvalues are at least `least`, and this share of its largest entry.
    """
    size = math.isqrt(len(covariance))
    matrix = np.reshape(covariance, (size, size))
    largest = float(np.max(np.abs(matrix)))
    if largest > MAX_POSE_M**2 or float(np.max(np.abs(matrix - matrix.T))) > 1e-6 * largest:
        return "a covariance that is too large or not symmetric"
    if float(np.linalg.eigvalsh(matrix)[0]) < max(least, share * largest):
        return "a covariance that is not positive definite"
    return None


def _field_problem(seen: steps.Observation | steps.Seen, field: steps.PositionField) -> str | None:
    if seen.landmark or len(seen.mean) != 2:
        return "a field with a landmark or a heading"
    try:
        sides = field.log_likelihoods.checked(None, None, dtype="float32").shape
    except MalformedMessageError as error:
        return error.problem
    most = steps.MAX_FIELD_SIDE
    is_small = all(0 < side <= most for side in sides)
    return None if is_small else f"a field of {sides} cells; {most} x {most} are possible"


def stamp_problem(stamp_ns: int) -> Cause | None:
    """Return `Cause.NOT_FINITE` for a stamp outside the range of a robot's clock, else None."""
    return None if abs(stamp_ns) < _MAX_STAMP_NS else Cause.NOT_FINITE


def pose_problem(pose: PoseTuple) -> Cause | None:
    """Return `Cause.NOT_FINITE` for a pose that is not finite or out of range, else None."""
    usable = max(abs(pose[0]), abs(pose[1])) < MAX_POSE_M and math.isfinite(sum(pose))
    return None if usable else Cause.NOT_FINITE


def _geometry_problem(reading: _Laser, shape: Sequence[int]) -> Cause | None:
    if len(shape) != 1:
        return Cause.MALFORMED
    beams = shape[0]
    if beams == 0:
        return Cause.NO_BEAMS
    if beams > steps.MAX_BEAMS:
        return Cause.TOO_MANY_BEAMS
    if not (math.isfinite(reading.angle_min_rad) and math.isfinite(reading.angle_step_rad)):
        return Cause.NOT_FINITE
    field_rad = abs(reading.angle_step_rad) * (beams - 1)
    if (beams > 1 and field_rad == 0.0) or field_rad > 1.01 * math.tau:
        return Cause.BAD_GEOMETRY
    return None


def _ranges_problem(
    ranges: NDArray[np.floating], range_min_m: float, range_max_m: float
) -> Cause | None:
    if math.isnan(range_max_m):
        return Cause.NOT_FINITE
    # One return is enough, and mostly one of the first few is well within the limits. Checking
    # these as plain numbers takes a quarter of the time of the array operation below.
    least, most = 1.001 * range_min_m, 0.999 * range_max_m
    if any(reading > 0.0 and least <= reading < most for reading in ranges[:_SOME].tolist()):
        return None
    if ranges.dtype == np.float32 and abs(range_max_m) > _LARGEST_FLOAT32:
        range_max_m = math.copysign(math.inf, range_max_m)  # its value as a float32
    # NaN and infinity fail `< range_max_m`, even if that is infinite.
    returned = (ranges > 0.0) & (ranges >= range_min_m) & (ranges < range_max_m)
    return None if returned.any() else Cause.NO_RETURNS
