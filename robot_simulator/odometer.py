"""Simulated wheel odometry with systematic and random errors."""

from math import sqrt

import numpy as np

from protocol.message import PoseTuple
from robot_simulator.robot import Drive, driven


class Odometer:
    """Dead reckoning with errors. Systematic errors are drawn once, random errors each time.

    Args:
        rng: source of the errors.
        scale_error: standard deviation of the systematic scale error of distances, and of that
            of turns (worn wheels, soft floors).
        veer_rad_per_m: standard deviation of the systematic turn per metre (unequal wheels).
        distance_noise_m: standard deviation of the distance after one metre. Like the noises
            below it grows with the square root of the motion.
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
        """Add one motion with its errors; no motion adds none."""
        metres, radians = abs(drive.distance_m), abs(drive.turn_rad)
        along, about = self._rng.standard_normal(2).tolist()
        distance_m = self._distance_scale * drive.distance_m
        distance_m += sqrt(self._distance_variance_per_m * metres) * along
        turn_rad = self._turn_scale * drive.turn_rad + self._veer_rad_per_m * drive.distance_m
        variance = self._turn_variance_per_rad * radians + self._turn_variance_per_m * metres
        turn_rad += sqrt(variance) * about
        self.odom_from_robot = driven(self.odom_from_robot, Drive(distance_m, turn_rad))
