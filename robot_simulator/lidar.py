"""A laser scanner: rays into the world, with noise and beams that do not return."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.arrays import Points, Pose
from particle_filter.poses import compose, inverse
from particle_filter.ray_casting import cast_rays_from_poses, jump_field
from protocol.message import PoseTuple


@dataclass(frozen=True, kw_only=True)
class LidarModel:
    """How good the scanner is.

    Args:
        beams: of one scan.
        field_of_view_rad: from the first beam, on the right, to the last, on the left.
        range_max_m: how far it sees.
        range_noise_m: standard deviation of a range.
        drop_out_share: of the beams that hit something but do not return.
        robot_from_laser: where it sits on the robot.
    """

    beams: int = 181
    field_of_view_rad: float = np.pi
    range_max_m: float = 12.0
    range_noise_m: float = 0.02
    drop_out_share: float = 0.01
    robot_from_laser: PoseTuple = (0.1, 0.0, 0.0)
    angles: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    """(beams,) directions in the laser's frame [rad]."""

    @property
    def angle_step_rad(self) -> float:
        """From one beam to the next."""
        return self.field_of_view_rad / (self.beams - 1)

    def __post_init__(self) -> None:
        if self.beams < 2:
            raise ValueError(f"a scan has at least two beams, not {self.beams}")
        half = self.field_of_view_rad / 2
        object.__setattr__(self, "angles", np.linspace(-half, half, self.beams))


class Lidar:
    """Scans a world.

    Args:
        model: how good it is.
        ground: what is really there.
        rng: draws noise and drop-outs.
    """

    def __init__(self, model: LidarModel, ground: GridMap, rng: np.random.Generator) -> None:
        self.model = model
        self._rng = rng
        self._jumps, self._cell_m = jump_field(ground.cells), ground.cell_m
        self._grid_from_map = inverse(np.array(ground.map_from_grid))
        self._robot_from_laser = np.array(model.robot_from_laser)

    def scan(
        self, map_from_robot: PoseTuple, people: Points, radius_m: float
    ) -> NDArray[np.float64]:
        """One scan.

        Args:
            map_from_robot: (3,) where it is taken.
            people: (P, 2) discs that stand in the way [m].
            radius_m: of each disc.

        Returns:
            (beams,) ranges [m], counter-clockwise; infinite: no return.
        """
        model = self.model
        map_from_laser = compose(np.array(map_from_robot), self._robot_from_laser)
        grid_from_laser = compose(self._grid_from_map, map_from_laser)[None]
        ranges = cast_rays_from_poses(
            self._jumps, self._cell_m, grid_from_laser, model.angles, model.range_max_m
        ).reshape(-1)
        if len(people):
            ranges = np.minimum(ranges, _to_discs(map_from_laser, model.angles, people, radius_m))
        lost = self._rng.random(model.beams) < model.drop_out_share
        lost |= ranges >= model.range_max_m
        noisy = ranges + model.range_noise_m * self._rng.standard_normal(model.beams)
        lost |= noisy >= model.range_max_m
        return np.where(lost, np.inf, np.maximum(noisy, 0.001))


def _to_discs(
    map_from_laser: Pose, angles: NDArray[np.float64], discs: Points, radius_m: float
) -> NDArray[np.float64]:
    """(B,) distance to the nearest of some discs along each beam [m]; infinite: none is hit.

    Discs that hold the laser itself are passed over: one would hide all the rest.
    """
    headings = map_from_laser[2] + angles
    x, y = (discs - map_from_laser[:2]).T
    along = np.outer(np.cos(headings), x) + np.outer(np.sin(headings), y)
    square = radius_m**2 - (x**2 + y**2) + along**2
    hit = (square >= 0.0) & (along > 0.0) & (x**2 + y**2 > radius_m**2)
    distance = np.where(hit, along - np.sqrt(np.maximum(square, 0.0)), np.inf)
    return np.asarray(distance.min(axis=1))
