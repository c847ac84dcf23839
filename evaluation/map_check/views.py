"""Computes the scans expected along a short path in a map, without noise or people."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.arrays import Points, Pose, Poses
from particle_filter.poses import between, compose, inverse
from particle_filter.ray_casting import cast_rays_from_poses, jump_field
from robot_simulator.free_space import FreeSpace

WAY_M = 4.0
"""Greatest length of the path of a view [m]: several scans show more than one."""
_SCANS, _BEAMS = 4, 60
_ANGLES = np.linspace(-np.pi, np.pi, _BEAMS, endpoint=False)
_DIFFERS_M = 0.3


@dataclass(frozen=True, eq=False)
class View:
    """The scans along a path."""

    map_from_robot: Pose
    """(3,) pose at the end of the path."""
    robot_from_scans: Poses
    """(S, 3) poses of the robot at the scans, relative to the end of the path."""
    hits_in_robot: Points
    """(n, 2) end points of all beams that returned, relative to the end of the path [m]."""
    ranges: NDArray[np.float64]
    """(S, B) ranges [m]; the laser's maximum range where nothing was hit."""

    @property
    def returned_share(self) -> float:
        """Share of the beams that hit something."""
        return len(self.hits_in_robot) / self.ranges.size


class Viewer:
    """Computes views of a map.

    Args:
        grid_map: the map.
        range_m: range of the laser, which scans 360 degrees.

    Raises:
        NoRoomError: no robot fits into the map.
    """

    def __init__(self, grid_map: GridMap, range_m: float) -> None:
        self._range_m, self._cell_m = range_m, grid_map.cell_m
        self._jumps = jump_field(grid_map.cells)
        self._grid_from_map = inverse(np.array(grid_map.map_from_grid))
        self._free_space = FreeSpace(grid_map)

    def random_view(self, rng: np.random.Generator) -> View:
        """Return the scans along a random short path."""
        x, y, heading = self._free_space.random_pose(rng)
        way = self._free_space.random_path(x, y, WAY_M, rng)
        chosen = way[np.unique(np.linspace(0, len(way) - 1, _SCANS).astype(int))]
        poses: Poses = np.column_stack([chosen, np.full(len(chosen), heading)])
        return self._view(poses)

    def differing_share(self, view: View, places: Poses) -> NDArray[np.float64]:
        """Return the (N,) share of the view's beams whose range differs at (N, 3) places."""
        return np.array(
            [
                np.mean(np.abs(self._ranges(compose(place, view.robot_from_scans)) - view.ranges)
                        > _DIFFERS_M)
                for place in places
            ]
        )  # fmt: skip

    def _view(self, poses: Poses) -> View:
        end, ranges = poses[-1], self._ranges(poses)
        robot_from_scans = between(end, poses)
        returned = ranges < self._range_m
        rays = np.stack([ranges * np.cos(_ANGLES), ranges * np.sin(_ANGLES)], axis=-1)[returned]
        scan = np.nonzero(returned)[0]
        ends = compose(robot_from_scans[scan], np.column_stack([rays, np.zeros(len(rays))]))
        return View(end, robot_from_scans, ends[:, :2], ranges)

    def _ranges(self, poses: Poses) -> NDArray[np.float64]:
        in_grid = compose(self._grid_from_map, poses)
        return cast_rays_from_poses(self._jumps, self._cell_m, in_grid, _ANGLES, self._range_m)
