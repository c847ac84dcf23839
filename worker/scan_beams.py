"""The beams of a scan that are scored."""

from functools import lru_cache

import numpy as np

from particle_filter.sensor_model import Beams, LaserScan, SensorModel
from protocol.steps import Scan


@lru_cache(maxsize=1)
def scan_beams(scan: Scan, model: SensorModel) -> Beams:
    """The beams of a scan that are scored; all jobs of a process share those of the last scan."""
    measured = LaserScan(
        scan.ranges.array(),
        scan.range_max_m,
        scan.angle_min_rad,
        scan.angle_step_rad,
        np.array(scan.robot_from_laser),
    )
    return model.beams(measured)
