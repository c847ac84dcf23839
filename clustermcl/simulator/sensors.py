"""Simulated sensors: wheel odometry with its errors, a laser scanner, and a camera."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import hypot, sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.poses import between, compose
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark, Observation
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.robot import Drive, driven

SCALE_ERROR = 0.02
"""Standard deviation of the scale error of distances, and of turns (worn wheels, soft floors)."""
VEER_RAD_PER_M = 0.004
"""Standard deviation of the systematic turn per metre (unequal wheels)."""
DISTANCE_NOISE_M = 0.03
"""Standard deviation of the distance after driving one metre."""
TURN_NOISE_RAD, TURN_NOISE_PER_METRE_RAD = 0.03, 0.02
"""Standard deviations of the turn after turning by one radian, and after driving one metre."""

Observe: TypeAlias = Callable[
    [int, PoseTuple, Sequence[Landmark], np.random.Generator], Iterator[Observation]
]
"""Yields observations by time [ns], pose in the map, and landmarks of the map."""


class Odometer:
    """Wheel odometry with systematic errors, drawn once, and random errors of each motion.

    Standard deviations of random errors grow with the square root of the motion.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self.odom_from_robot: PoseTuple = (0.0, 0.0, 0.0)
        self._rng = rng
        distance, turn, veer = rng.standard_normal(3).tolist()
        self._distance_scale = 1.0 + SCALE_ERROR * distance
        self._turn_scale = 1.0 + SCALE_ERROR * turn
        self._veer_rad_per_m = VEER_RAD_PER_M * veer

    def read(self, drive: Drive) -> None:
        """Add a motion and its errors to `odom_from_robot`; no motion has no errors."""
        metres, radians = abs(drive.distance_m), abs(drive.turn_rad)
        along, about = self._rng.standard_normal(2).tolist()
        distance_m = self._distance_scale * drive.distance_m
        distance_m += sqrt(DISTANCE_NOISE_M**2 * metres) * along
        turn_rad = self._turn_scale * drive.turn_rad + self._veer_rad_per_m * drive.distance_m
        variance = TURN_NOISE_RAD**2 * radians + TURN_NOISE_PER_METRE_RAD**2 * metres
        turn_rad += sqrt(variance) * about
        self.odom_from_robot = driven(self.odom_from_robot, Drive(distance_m, turn_rad))


@dataclass(frozen=True, kw_only=True)
class LidarModel:
    """Parameters of a laser scanner, whose beams run from right to left.

    A share of them, `drop_out_share`, does not return although they hit something.
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


Ranges: TypeAlias = Callable[[Pose, NDArray[np.float64]], NDArray[np.float64]]


class Lidar:
    """A simulated laser scanner."""

    def __init__(self, model: LidarModel, ground: GridMap, rng: np.random.Generator) -> None:
        self.model, self._rng = model, rng
        self._jumps, self._grid = jump_field(ground.cells), ground.grid
        self._robot_from_laser = np.array(model.robot_from_laser)

    def scan(self, map_from_robot: PoseTuple, exact: Ranges | None = None) -> NDArray[np.float64]:
        """Return (beams,) ranges, counter-clockwise [m]; infinite: no return.

        `exact` returns ranges without noise by the laser's pose and directions; None: of the map.
        """
        model = self.model
        map_from_laser = compose(np.array(map_from_robot), self._robot_from_laser)
        ranges = exact(map_from_laser, model.angles) if exact else self.exact_ranges(map_from_laser)
        lost = self._rng.random(model.beams) < model.drop_out_share
        lost |= ranges >= model.range_max_m
        noisy = ranges + model.range_noise_m * self._rng.standard_normal(model.beams)
        lost |= noisy >= model.range_max_m
        return np.where(lost, np.inf, np.maximum(noisy, 0.001))

    def exact_ranges(self, map_from_laser: Pose) -> NDArray[np.float64]:
        """Return (beams,) ranges without noise [m]."""
        angles, range_max_m = self.model.angles, self.model.range_max_m
        seen = self._jumps, self._grid, map_from_laser[None], angles, range_max_m
        return cast_rays_from_poses(*seen).reshape(-1)


@dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera that sees all landmarks within its range, also through walls.

    A share of its observations, `false_names`, has the name of a random landmark.
    """

    range_m: float = 3.0
    sigma_m: float = 0.1
    false_names: float = 0.0

    def observe(
        self,
        stamp_ns: int,
        map_from_robot: PoseTuple,
        landmarks: Sequence[Landmark],
        rng: np.random.Generator,
    ) -> Iterator[Observation]:
        for landmark in landmarks:
            at = np.array([landmark.x, landmark.y, 0.0])
            seen = between(np.array(map_from_robot), at)[:2]
            if hypot(*seen) > self.range_m:
                continue
            is_false = rng.random() < self.false_names
            named = landmarks[int(rng.integers(len(landmarks)))] if is_false else landmark
            mean = (seen + self.sigma_m * rng.standard_normal(2)).tolist()
            yield Observation(
                sender="camera",
                stamp_ns=stamp_ns,
                landmark=named.name,
                mean=tuple(mean),
                covariance=(self.sigma_m**2, 0.0, 0.0, self.sigma_m**2),
                outlier_probability=max(self.false_names, 0.05),
                correlation_s=30.0,
            )
