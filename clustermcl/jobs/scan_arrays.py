"""A scan as the arrays that jobs weigh: beams, observations, and its mirror image."""

import dataclasses
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from clustermcl.filter.arrays import Pose
from clustermcl.filter.laser.sensor_model import Beams, LaserScan, SensorModel
from clustermcl.filter.observations.kind import Landmarks
from clustermcl.filter.observations.likelihood import ObservationArrays
from clustermcl.filter.observations.observed import Observed
from clustermcl.jobs.wire_observations import from_wire
from clustermcl.protocol.steps import LaserBeams, Scan

T = TypeVar("T")
_KEPT = 2
"""The last scan and its mirror image."""


class ScanArrays:
    """Computes the arrays of a scan once for all jobs of a robot.

    Scans are compared by identity: hashing one takes longer than selecting its beams.
    """

    def __init__(self) -> None:
        self._kept: dict[Callable[..., Any], list[tuple[tuple[Any, ...], Any]]] = {}

    def once(self, compute: Callable[..., T], *arguments: object) -> T:
        """Return what `compute` makes of a scan and a model."""
        kept = self._kept.setdefault(compute, [])
        for known, result in kept:
            if all(one is other for one, other in zip(known, arguments, strict=True)):
                return result  # type: ignore[no-any-return] # of `compute`
        result = compute(*arguments)
        kept[:] = [(arguments, result), *kept[: _KEPT - 1]]
        return result


def scan_beams(scan: Scan, model: SensorModel) -> Beams:
    others = tuple(map(scan_of_laser, scan.others))
    measured = scan_of_laser(scan)
    return model.beams(dataclasses.replace(measured, others=others) if others else measured)


def scan_of_laser(beams: Scan | LaserBeams) -> LaserScan:
    return LaserScan(
        beams.ranges.array(),
        beams.range_max_m,
        beams.angle_min_rad,
        beams.angle_step_rad,
        np.array(beams.robot_from_laser),
    )


def motion_by_scans(scan: Scan, step_before: int) -> Pose | None:
    """Return the (3,) motion that contradicts odometry, for a job that has the step before."""
    motion = scan.motion_by_scans if scan.step == step_before + 1 else None
    return None if motion is None else np.array(motion)


def observed(scan: Scan) -> tuple[list[Observed], Landmarks]:
    """Return the observations of a step, and the landmarks of the map."""
    seen = [from_wire(each, each.share) for each in scan.observations]
    return seen, Landmarks.of((each.name, each.x, each.y, each.sigma) for each in scan.landmarks)


def observation_arrays(scan: Scan, model: SensorModel) -> ObservationArrays:
    return ObservationArrays.of(*observed(scan), model.grid)
