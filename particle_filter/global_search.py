"""Global MCL: where in the whole map the robot may be, from the first scan on (section 4).

Used for the first clusters and for every restart. The first scan is scored everywhere
(`grid_search.py`); the poses that come near the best are kept with their weights, move by odometry
and are weighed by each further scan. The heavier a pose, the finer the part of the map that it
stands for is looked at: it is split into several, spread over that part. None is drawn away by
chance: a pose leaves only when it is worse than the best by a margin, or when there are too many.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Pose, Poses
from particle_filter.cluster_filter import Cloud
from particle_filter.gaussian import fit_gaussian
from particle_filter.grid_search import GridSearch, SearchSpace, informative
from particle_filter.ground import ground_log_penalty
from particle_filter.log_weights import normalised_weights
from particle_filter.motion import move
from particle_filter.resampling import resample, thinned
from particle_filter.sensor_model import Beams, SensorModel
from particle_filter.settings import FilterSettings, SearchSettings
from particle_filter.source_clustering import Labels, cluster_by_source_point

_REFINEMENTS = 2
"""Times that the leaves of the first scan are split and scored again."""
_CORRECTED_SHARE = 0.01
"""Places with a smaller share are not looked at for beams through walls: rays are dear."""
_EVENLY = np.array([0.8191725134, 0.6710436067, 0.5497004779])
"""Multiples of these, less the whole part, fill a cube evenly (Roberts, 2018)."""


@dataclass(frozen=True)
class FoundPlace:
    """One place that a search holds possible."""

    share: float
    mean: Pose
    covariance: Poses
    sample: Poses
    """(M, 3) particles drawn from it, all alike."""


@lru_cache(maxsize=2)
def search_space(model: SensorModel, settings: SearchSettings) -> SearchSpace:
    """The leaves of a model's map; the shards and searches of a process share them."""
    return SearchSpace(model.grid, model.pooled.side, settings.heading_step_rad, settings.shards)


@dataclass(frozen=True)
class _Kept:
    """Poses, each for the part of the map around it."""

    poses: Poses
    log_weights: LogWeights
    """(N,) log of the part's size, of the whole space, times the likelihood of all scans."""
    sizes: NDArray[np.float64]
    """(N,) sides of the part, in those of a leaf."""

    def at(self, chosen: NDArray[np.int64]) -> "_Kept":
        return _Kept(self.poses[chosen], self.log_weights[chosen], self.sizes[chosen])


class GlobalSearch:
    """One shard of a global search, step by step.

    Raises:
        ValueError: the map has no free cell.
    """

    def __init__(self, model: SensorModel, settings: FilterSettings, shard: int) -> None:
        self._model, self._settings, self._shard = model, settings, shard
        self._rules = settings.search
        self._space = search_space(model, settings.search)
        self._most = max(self._rules.poses // self._rules.shards, 1)
        self._kept: _Kept | None = None
        self._labels: Labels = np.empty(0, np.int32)
        self.log_evidence = 0.0
        """Log of the average likelihood of all scans so far over the shard's part of the space."""
        self.left_out_gap = math.inf
        """Leaves left out were worse than the best of the first scan by this at least [nat]."""

    @property
    def poses(self) -> int:
        """How many are kept."""
        return 0 if self._kept is None else len(self._kept.poses)

    def advance(
        self,
        odom_from_before: Pose | None,
        odom_from_after: Pose,
        beams: Beams,
        rng: np.random.Generator,
    ) -> float:
        """One step; the first one does not move, for nothing is known from before.

        Returns:
            The best pose's log-likelihood a beam, without the exponent; NaN of an empty scan.
        """
        if self._kept is None:
            return self._search(beams, rng) if informative(beams) else math.nan
        if odom_from_before is None:
            raise ValueError("odometry must tell the way from the step before")
        kept = self._split(self._kept, rng)[0] if beams.count else self._kept
        motion = self._settings.motion
        moved = move(kept.poses, odom_from_before, odom_from_after, motion, rng)
        self._kept = replace(kept, poses=moved)
        return self._weigh(self._kept, beams, rng) if beams.count else math.nan

    def places(self, rng: np.random.Generator) -> list[FoundPlace]:
        """The clusters by source point, most probable first (section 4)."""
        if self._kept is None:
            return []
        cloud = Cloud(self._kept.poses, self._kept.log_weights)
        return _places(cloud, self._labels, self._rules, self._rules.min_place_share, rng)

    def _search(self, beams: Beams, rng: np.random.Generator) -> float:
        """The first scan."""
        grid = GridSearch(self._model, self._space, beams, self._shard, self._rules)
        while grid.advance():
            pass
        leaves = grid.leaves()
        self.left_out_gap = float(leaves.scores.max()) - leaves.left_out
        scores = leaves.scores
        kept = _Kept(
            leaves.map_from_robot, scores - math.log(self._space.leaf_count), np.ones(len(scores))
        )
        for _ in range(_REFINEMENTS):
            kept, chosen = self._thin(kept, rng)
            kept, parent = self._split(kept, rng, also_unsplit=True)
            # Leaves reach into walls at their sides: where no robot can be there is nothing.
            free = np.flatnonzero(self._penalty(kept.poses, -1.0) == 0.0)
            kept, parent = kept.at(free), parent[free]
            before = kept.log_weights - scores[chosen][parent]
            scores = self._exponent * self._model.log_likelihood(kept.poses, beams)
            kept = replace(kept, log_weights=before + scores)
        self._settle(self._thin(kept, rng)[0], beams)
        return leaves.log_likelihood_per_beam

    def _weigh(self, kept: _Kept, beams: Beams, rng: np.random.Generator) -> float:
        fits = self._model.log_likelihood(kept.poses, beams)
        penalty = self._penalty(kept.poses, self._model.settings.not_free_log_penalty)
        log_weights = kept.log_weights + self._exponent * fits + penalty
        kept, _ = self._thin(replace(kept, log_weights=log_weights), rng)
        self._settle(kept, beams)
        return float(fits.max()) / beams.count

    @property
    def _exponent(self) -> float:
        return self._model.settings.scan_likelihood_exponent

    def _penalty(self, poses: Poses, log_penalty: float) -> LogWeights:
        grid = self._model.grid
        return ground_log_penalty(poses, grid.cells, grid.cell_m, grid.map_from_grid, log_penalty)

    def _split(
        self, kept: _Kept, rng: np.random.Generator, *, also_unsplit: bool = False
    ) -> tuple[_Kept, NDArray[np.int64]]:
        """Split the heavy poses, so that all together weigh and cover what they did before.

        Args:
            kept: the poses.
            rng: spreads the parts of each over what it stands for.
            also_unsplit: let the light ones, too, be anywhere in what they stand for.

        Returns:
            The poses, and which one each comes from.
        """
        weights = normalised_weights(kept.log_weights)
        copies = np.maximum(np.ceil(0.5 * self._most * weights).astype(np.int64), 1)
        parent = np.repeat(np.arange(len(copies)), copies)
        number = np.arange(len(parent)) - np.repeat(np.cumsum(copies) - copies, copies)
        across = number[:, None] * _EVENLY + rng.random(3)
        spread = (across - np.floor(across) - 0.5) * self._space.cell * kept.sizes[parent, None]
        stays = (copies[parent] == 1) & (not also_unsplit)
        return _Kept(
            kept.poses[parent] + np.where(stays[:, None], 0.0, spread),
            kept.log_weights[parent] - np.log(copies)[parent],
            kept.sizes[parent] * copies[parent] ** (-1.0 / 3.0),
        ), parent

    def _thin(self, kept: _Kept, rng: np.random.Generator) -> tuple[_Kept, NDArray[np.int64]]:
        """Half of what may be at most: room to split."""
        chosen, log_weights = thinned(kept.log_weights, max(self._most // 2, 1), rng)
        return replace(kept.at(chosen), log_weights=log_weights), chosen

    def _settle(self, kept: _Kept, beams: Beams) -> None:
        """After a scan: find the places, and take back what was given for looks through walls."""
        labels, count = _clustered(kept.poses, kept.log_weights, self._rules)
        taken_back = self._corrections(kept, labels, count, beams)[labels]
        self._kept, self._labels = replace(kept, log_weights=kept.log_weights - taken_back), labels
        self.log_evidence = float(np.logaddexp.reduce(self._kept.log_weights))

    def _corrections(
        self, kept: _Kept, labels: Labels, count: int, beams: Beams
    ) -> NDArray[np.float64]:
        """For each place, and last for poses of none, what is taken back of its evidence."""
        corrections = np.zeros(count + 1)
        weights = normalised_weights(kept.log_weights)
        shares = np.bincount(labels[labels >= 0], weights[labels >= 0], minlength=count)
        for label in np.flatnonzero(shares >= _CORRECTED_SHARE):
            members = np.flatnonzero(labels == label)
            own = weights[members] / weights[members].sum()
            corrections[label] = self._model.correction(kept.poses[members], own, beams)
        return corrections


def places_of(
    cloud: Cloud, rules: SearchSettings, min_share: float, rng: np.random.Generator
) -> list[FoundPlace]:
    """Cluster a cloud by source points (section 4).

    Args:
        cloud: N particles.
        rules: how near a point must be to its cluster's source, and how large samples are.
        min_share: places with less of the weight are left out.
        rng: draws the samples.

    Returns:
        Most probable first.
    """
    labels, _ = _clustered(cloud.map_from_robot, cloud.log_weights, rules)
    return _places(cloud, labels, rules, min_share, rng)


def _clustered(poses: Poses, log_weights: LogWeights, rules: SearchSettings) -> tuple[Labels, int]:
    return cluster_by_source_point(
        poses, log_weights, rules.source_radius_m, rules.source_heading_rad, rules.places
    )


def _places(
    cloud: Cloud,
    labels: Labels,
    rules: SearchSettings,
    min_share: float,
    rng: np.random.Generator,
) -> list[FoundPlace]:
    weights = normalised_weights(cloud.log_weights)
    shares = np.bincount(labels[labels >= 0], weights[labels >= 0])
    found = []
    for label in np.argsort(-shares, kind="stable"):
        if shares[label] < min_share:
            break
        members = np.flatnonzero(labels == label)
        poses, log_weights = cloud.map_from_robot[members], cloud.log_weights[members]
        mean, covariance = fit_gaussian(poses, normalised_weights(log_weights))
        chosen = resample(log_weights, rules.hand_over_particles, "systematic", rng)
        found.append(FoundPlace(float(shares[label]), mean, covariance, poses[chosen]))
    return found
