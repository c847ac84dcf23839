"""A small room that the tests of the filter look at, and what a laser sees in it."""

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import OCCUPIED, Cells, Pose
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import Beams, LaserScan, SensorModel, computed_model
from clustermcl.filter.settings import MotionSettings, SensorSettings
from tests.unit.filter.naive_rays import cast_rays

CELL_M = 0.05
ANGLES = np.linspace(-np.pi, np.pi, 72, endpoint=False)
NO_OFFSET = np.zeros(3)
PERFECT_ODOMETRY = MotionSettings(
    turn_noise_per_turn=0.0, turn_noise_per_metre=0.0, drive_noise_per_metre=0.0,
    drive_noise_per_turn=0.0, strafe_noise_per_metre=0.0,
)  # fmt: skip


def symmetric_room() -> Cells:
    """6 m x 4 m, walls and two boxes; half a turn maps it on itself, cell by cell."""
    cells = np.zeros((80, 120), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    cells[20:32, 30:38] = OCCUPIED
    return np.asarray(np.maximum(cells, cells[::-1, ::-1]))


def plain_room() -> Cells:
    """The same with one box only: nothing else looks like it."""
    cells = symmetric_room()
    cells[48:60, 82:90] = 0
    return cells


def model_of(cells: Cells, settings: SensorSettings | None = None) -> SensorModel:
    return computed_model(Grid(cells, CELL_M, NO_OFFSET), settings or SensorSettings())


def scan_of(
    ranges: NDArray[np.float64],
    range_max_m: float,
    angles: NDArray[np.float64] = ANGLES,
    robot_from_laser: Pose = NO_OFFSET,
) -> LaserScan:
    """A scan of a laser whose beams have these even angles."""
    step = float(angles[1] - angles[0])
    return LaserScan(ranges, range_max_m, float(angles[0]), step, robot_from_laser)


def seen_from(pose: Pose, cells: Cells) -> Beams:
    ranges = cast_rays(cells, CELL_M, pose, ANGLES, 20.0)
    return model_of(cells).beams(scan_of(ranges, 20.0))
