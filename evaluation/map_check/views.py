"""What a robot would see on a short way in a map, by the map itself: no noise, nobody about."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.arrays import Points, Pose, Poses
from particle_filter.poses import between, compose, inverse
from particle_filter.ray_casting import cast_rays_from_poses, jump_field
from robot_simulator.free_space import FreeSpace

WAY_M = 4.0
"""At most. A robot that has driven a little has seen more than one scan shows."""
_SCANS, _BEAMS = 4, 60
_ANGLES = np.linspace(-np.pi, np.pi, _BEAMS, endpoint=False)
_DIFFERS_M = 0.3


@dataclass(frozen=True, eq=False)
class View:
    """What was seen on a way, from its end."""

    map_from_robot: Pose
    """(3,) where the robot is at the end of the way."""
    robot_from_scans: Poses
    """(S, 3) where it scanned on the way, seen from its end."""
    hits_in_robot: Points
    """(n, 2) where beams ended [m]."""
    ranges: NDArray[np.float64]
    """(S, B) [m]; the laser's range where nothing was hit."""

    @property
    def returned_share(self) -> float:
        """Of all beams, those that hit something."""
        return len(self.hits_in_robot) / self.ranges.size


class Viewer:
    """Looks at a map from anywhere.

    Args:
        grid_map: the map.
        range_m: how far the laser sees; it sees all around.

    Raises:
        NoRoomError: no robot fits into the map.
    """

    def __init__(self, grid_map: GridMap, range_m: float) -> None:
        self._range_m, self._cell_m = range_m, grid_map.cell_m
        self._jumps = jump_field(grid_map.cells)
        self._grid_from_map = inverse(np.array(grid_map.map_from_grid))
        self._free_space = FreeSpace(grid_map)

    def random_view(self, rng: np.random.Generator) -> View:
        """From a way between two random places that are not far from each other."""
        x, y, heading = self._free_space.random_pose(rng)
        way = self._free_space.random_path(x, y, WAY_M, rng)
        chosen = way[np.unique(np.linspace(0, len(way) - 1, _SCANS).astype(int))]
        poses: Poses = np.column_stack([chosen, np.full(len(chosen), heading)])
        return self._view(poses)

    def differing_share(self, view: View, places: Poses) -> NDArray[np.float64]:
        """(N,) share of the view's beams that would be of another length from (N, 3) places."""
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
