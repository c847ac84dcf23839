"""The beams of a scan that are scored."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from particle_filter.sensor_model import Beams, LaserScan, SensorModel
from protocol.steps import LaserBeams, Scan


@lru_cache(maxsize=1)
def scan_beams(scan: Scan, model: SensorModel) -> Beams:
    """The beams of a scan that are scored; all jobs of a process share those of the last scan."""
    others = tuple(map(_laser_scan, scan.others))
    measured = _laser_scan(scan)
    return model.beams(replace(measured, others=others) if others else measured)


def _laser_scan(beams: Scan | LaserBeams) -> LaserScan:
    return LaserScan(
        beams.ranges.array(),
        beams.range_max_m,
        beams.angle_min_rad,
        beams.angle_step_rad,
        np.array(beams.robot_from_laser),
    )
