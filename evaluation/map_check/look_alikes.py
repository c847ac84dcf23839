"""Finds look-alike places: places from which the laser's view is nearly the same."""

import math

import msgspec
import numpy as np

from evaluation.map_check.refining import refined
from evaluation.map_check.views import View, Viewer
from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, Poses
from particle_filter.likelihood_field import LikelihoodField, scan_log_likelihood
from particle_filter.places import cluster_by_source_point
from particle_filter.poses import compose, heading_distance
from particle_filter.settings import SensorSettings

MOST_POSES = 1_000_000
"""Largest number of poses scored for a view; a larger map has a coarser lattice."""
ALIKE_SHARE = 0.1
"""Share of differing beams below which two places look alike."""

_HEADINGS = 60
_SPACING_M = 0.4
_FEWEST_HITS, _COARSE_HITS = 10, 120
_KEPT_POSES, _KEPT_PLACES = 3_000, 64
_APART_M, _APART_RAD = 1.0, 0.5


class LookAlikeSearch:
    """Scores a view from all poses in the free space of a map.

    All poses on a lattice are scored with a blurred map; the best are refined, and their expected
    ranges compared with the view.

    Args:
        grid_map: the map.
        viewer: computes views of the same map.
        rng: source of the random trials.
    """

    def __init__(self, grid_map: GridMap, viewer: Viewer, rng: np.random.Generator) -> None:
        self._viewer, self._rng = viewer, rng
        room_m = math.sqrt(grid_map.free_area_m2 * _HEADINGS / MOST_POSES)
        self.spacing_m = max(_SPACING_M, room_m)
        self._lattice = _lattice(grid_map, self.spacing_m)
        usual = SensorSettings()
        blurred = msgspec.structs.replace(usual, hit_sigma_m=self.spacing_m)
        self._field, self._blurred = (
            LikelihoodField.build(grid_map.grid, settings) for settings in (usual, blurred)
        )

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
        poses = poses[far]
        alike = self._viewer.differing_share(view, poses) < ALIKE_SHARE
        return np.vstack([own, poses[alike]])


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
