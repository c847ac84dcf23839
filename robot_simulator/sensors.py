"""Simulated sensors: wheel odometry with its errors, and a laser scanner."""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.arrays import Pose
from particle_filter.poses import compose, inverse
from particle_filter.ray_casting import cast_rays_from_poses, jump_field
from protocol.message import PoseTuple
from robot_simulator.robot import Drive, driven


class Odometer:
    """Wheel odometry with systematic errors, drawn once, and random errors of each motion.

    Standard deviations of random errors grow with the square root of the motion.

    Args:
        rng: random numbers for the errors.
        scale_error: standard deviation of the scale error of distances, and of turns (worn
            wheels, soft floors).
        veer_rad_per_m: standard deviation of the systematic turn per metre (unequal wheels).
        distance_noise_m: standard deviation of the distance after driving one metre.
        turn_noise_rad: standard deviation of the turn after turning by one radian.
        turn_noise_per_metre_rad: standard deviation of the turn after driving one metre.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        *,
        scale_error: float = 0.02,
        veer_rad_per_m: float = 0.004,
        distance_noise_m: float = 0.03,
        turn_noise_rad: float = 0.03,
        turn_noise_per_metre_rad: float = 0.02,
    ) -> None:
        self.odom_from_robot: PoseTuple = (0.0, 0.0, 0.0)
        self._rng = rng
        self._distance_scale = 1.0 + scale_error * float(rng.standard_normal())
        self._turn_scale = 1.0 + scale_error * float(rng.standard_normal())
        self._veer_rad_per_m = veer_rad_per_m * float(rng.standard_normal())
        self._distance_variance_per_m = distance_noise_m**2
        self._turn_variance_per_rad = turn_noise_rad**2
        self._turn_variance_per_m = turn_noise_per_metre_rad**2

    def read(self, drive: Drive) -> None:
        """Add a motion and its errors to `odom_from_robot`; no motion has no errors."""
        metres, radians = abs(drive.distance_m), abs(drive.turn_rad)
        along, about = self._rng.standard_normal(2).tolist()
        distance_m = self._distance_scale * drive.distance_m
        distance_m += sqrt(self._distance_variance_per_m * metres) * along
        turn_rad = self._turn_scale * drive.turn_rad + self._veer_rad_per_m * drive.distance_m
        variance = self._turn_variance_per_rad * radians + self._turn_variance_per_m * metres
        turn_rad += sqrt(variance) * about
        self.odom_from_robot = driven(self.odom_from_robot, Drive(distance_m, turn_rad))


@dataclass(frozen=True, kw_only=True)
class LidarModel:
    """Parameters of a laser scanner.

    Args:
        beams: number of beams in a scan, at least two.
        field_of_view_rad: angle from the first beam (right) to the last (left).
        range_max_m: maximum range.
        range_noise_m: standard deviation of a range.
        drop_out_share: share of the beams that do not return although they hit something.
        robot_from_laser: mount on the robot: x [m], y [m], heading [rad].
    """

    beams: int = 181
    field_of_view_rad: float = np.pi
    range_max_m: float = 12.0
    range_noise_m: float = 0.02
    drop_out_share: float = 0.01
    robot_from_laser: PoseTuple = (0.1, 0.0, 0.0)

    @property
    def angle_step_rad(self) -> float:
        return self.field_of_view_rad / (self.beams - 1)

    @property
    def angles(self) -> NDArray[np.float64]:
        """(beams,) directions in the laser's frame [rad]."""
        half = self.field_of_view_rad / 2
        return np.linspace(-half, half, self.beams)


class Lidar:
    """A simulated laser scanner."""

    def __init__(self, model: LidarModel, ground: GridMap, rng: np.random.Generator) -> None:
        self.model = model
        self._rng = rng
        self._jumps, self._cell_m = jump_field(ground.cells), ground.cell_m
        self._grid_from_map = inverse(np.array(ground.map_from_grid))
        self._robot_from_laser = np.array(model.robot_from_laser)

    def scan(self, map_from_robot: PoseTuple) -> NDArray[np.float64]:
        """Simulate a scan from a pose of the robot: x [m], y [m], heading [rad].

        Returns:
            (beams,) ranges, counter-clockwise [m]; infinite: no return.
        """
        model = self.model
        ranges = self.exact_ranges(compose(np.array(map_from_robot), self._robot_from_laser))
        lost = self._rng.random(model.beams) < model.drop_out_share
        lost |= ranges >= model.range_max_m
        noisy = ranges + model.range_noise_m * self._rng.standard_normal(model.beams)
        lost |= noisy >= model.range_max_m
        return np.where(lost, np.inf, np.maximum(noisy, 0.001))

    def exact_ranges(self, map_from_laser: Pose) -> NDArray[np.float64]:
        """Return (beams,) ranges without noise [m]."""
        angles, range_max_m = self.model.angles, self.model.range_max_m
        grid_from_laser = compose(self._grid_from_map, map_from_laser)[None]
        return cast_rays_from_poses(
            self._jumps, self._cell_m, grid_from_laser, angles, range_max_m
        ).reshape(-1)
