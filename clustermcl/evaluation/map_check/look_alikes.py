"""Finds look-alike places: places from which the laser's view along a short path is the same.

A view is expected from the map, without noise or people.
"""

import math
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, LogWeights, Points, Pose, Poses
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.poses import between, compose, heading_distance
from clustermcl.filter.search.places import cluster_by_source_point
from clustermcl.filter.settings import SensorSettings
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.free_space import FreeSpace

MOST_POSES = 1_000_000
"""Largest number of poses scored for a view; a larger map has a coarser lattice."""
ALIKE_SHARE = 0.1
"""Share of differing beams below which two places look alike."""

_HEADINGS = 60
_SPACING_M = 0.4
_FEWEST_HITS, _COARSE_HITS = 10, 120
_KEPT_POSES, _KEPT_PLACES = 3_000, 64
_APART_M, _APART_RAD = 1.0, 0.5

WAY_M = 4.0
"""Greatest length of the path of a view [m]: several scans show more than one."""
_SCANS, _BEAMS = 4, 60
_ANGLES = np.linspace(-np.pi, np.pi, _BEAMS, endpoint=False)
_DIFFERS_M = 0.3
_TRIES = 200
_SPREADS = np.array([(s, s, 0.25 * s) for s in (0.4, 0.2, 0.1, 0.05, 0.02)])
"""Standard deviations of the trials: x [m], y [m], heading [rad]. That of the heading is a
quarter, because beams end metres away."""


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


class LookAlikeSearch:
    """Draws views of a map, and finds the places from which a view is nearly the same.

    The laser scans 360 degrees. All poses on a lattice in the free space are scored with a blurred
    map; the best are refined, and their expected ranges compared with the view.

    Raises:
        NoRoomError: no robot fits into the map.
    """

    def __init__(self, grid_map: GridMap, range_m: float, rng: np.random.Generator) -> None:
        self._range_m, self._rng, self._grid = range_m, rng, grid_map.grid
        self._jumps = jump_field(grid_map.cells)
        self._free_space = FreeSpace(grid_map)
        room_m = math.sqrt(grid_map.grid.free_m2 * _HEADINGS / MOST_POSES)
        spacing_m = max(_SPACING_M, room_m)
        self._lattice = _lattice(grid_map, spacing_m)
        usual = SensorSettings()
        blurred = msgspec.structs.replace(usual, hit_sigma_m=spacing_m)
        self._field, self._blurred = (
            LikelihoodField.build(grid_map.grid, settings) for settings in (usual, blurred)
        )

    def random_view(self) -> View:
        x, y, heading = self._free_space.random_pose(self._rng)
        way = self._free_space.random_path(x, y, WAY_M, self._rng)
        chosen = way[np.unique(np.linspace(0, len(way) - 1, _SCANS).astype(int))]
        poses: Poses = np.column_stack([chosen, np.full(len(chosen), heading)])
        ranges, robot_from_scans = self._ranges(poses), between(poses[-1], poses)
        returned = ranges < self._range_m
        rays = np.stack([ranges * np.cos(_ANGLES), ranges * np.sin(_ANGLES)], axis=-1)[returned]
        scan = np.nonzero(returned)[0]
        ends = compose(robot_from_scans[scan], np.column_stack([rays, np.zeros(len(rays))]))
        return View(poses[-1], robot_from_scans, ends[:, :2], ranges)

    def places_like(self, view: View) -> Poses:
        """Return the (N, 3) places from which nearly all beams of the view have the same range.

        The first is the place of the view. A view of fewer than 10 returns has no look-alikes.
        """
        if len(view.hits_in_robot) < _FEWEST_HITS:
            return view.map_from_robot[None]
        coarse = view.hits_in_robot[:: math.ceil(len(view.hits_in_robot) / _COARSE_HITS)]
        scores = scan_log_likelihood(self._lattice, coarse, self._blurred)
        count = min(_KEPT_POSES, len(scores))
        best = np.argpartition(-scores, count - 1)[:count]
        heads = _best_of_each_place(self._lattice[best], scores[best])[:_KEPT_PLACES]
        poses, found = refined(heads, view.hits_in_robot, self._field, self._rng)
        poses = _best_of_each_place(poses, found)
        own = view.map_from_robot
        far = np.hypot(*(poses - own)[:, :2].T) > _APART_M
        far |= heading_distance(poses[:, 2], own[2]) > _APART_RAD
        return np.vstack([own, *(pose for pose in poses[far] if self._looks_alike(view, pose))])

    def _looks_alike(self, view: View, place: Pose) -> bool:
        off_m = np.abs(self._ranges(compose(place, view.robot_from_scans)) - view.ranges)
        return bool(np.mean(off_m > _DIFFERS_M) < ALIKE_SHARE)

    def _ranges(self, poses: Poses) -> NDArray[np.float64]:
        return cast_rays_from_poses(self._jumps, self._grid, poses, _ANGLES, self._range_m)


def _lattice(grid_map: GridMap, spacing_m: float) -> Poses:
    """Return (N, 3) poses: free cells at the given spacing, with evenly spaced headings."""
    stride = max(1, round(spacing_m / grid_map.cell_m))
    places = np.argwhere(grid_map.cells[stride // 2 :: stride, stride // 2 :: stride] == FREE)
    middles = (places[:, ::-1] * stride + stride // 2 + 0.5) * grid_map.cell_m
    headings = np.linspace(-np.pi, np.pi, _HEADINGS, endpoint=False)
    in_grid = np.column_stack(
        [np.repeat(middles, _HEADINGS, axis=0), np.tile(headings, len(middles))]
    )
    return compose(np.array(grid_map.map_from_grid), in_grid)


def _best_of_each_place(poses: Poses, scores: np.ndarray) -> Poses:
    """Return the (K, 3) best pose of each place, best first."""
    order = np.argsort(-scores, kind="stable")
    labels, _ = cluster_by_source_point(
        poses[order], scores[order], _APART_M, _APART_RAD, max_clusters=len(poses)
    )
    _, first = np.unique(labels, return_index=True)
    return poses[order][np.sort(first)]


def refined(
    poses: Poses, hits_in_robot: Points, field: LikelihoodField, rng: np.random.Generator
) -> tuple[Poses, LogWeights]:
    """Improve each of (N, 3) poses by trials in a shrinking neighbourhood.

    Return the poses, none less likely by the (B, 2) hits [m] than before, and their
    (N,) log-likelihoods.
    """
    every = np.arange(len(poses))
    for spread in _SPREADS:
        steps = spread * rng.standard_normal((len(poses), _TRIES, 3))
        steps[:, 0] = 0.0
        tried = poses[:, None, :] + steps
        scores = scan_log_likelihood(tried.reshape(-1, 3), hits_in_robot, field)
        best = scores.reshape(len(poses), _TRIES).argmax(axis=1)
        poses, found = tried[every, best], scores.reshape(len(poses), _TRIES)[every, best]
    return poses, found
