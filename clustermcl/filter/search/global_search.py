"""Global localization, which finds all possible poses of the robot from the first scan on.

It finds the first clusters, and new ones at each periodic restart. Branch and bound scores the
first scan for the whole map (`branch_and_bound.py`). Poses with a score near the best are kept,
move by odometry, and are weighed by each further scan. A heavy pose is split into several, spread
over the part of the map that it stands for. If more poses are possible than can be kept,
the whole map is searched again by several scans, which odometry joins.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor, log

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Points, Pose, Poses
from clustermcl.filter.cluster.cluster_filter import ParticleSet, new_share
from clustermcl.filter.kernels.compiled import kernel
from clustermcl.filter.laser.beam_fits import beam_fits, decoded
from clustermcl.filter.laser.evidence_model import (
    THROUGH_WEIGHT,
    VIEW_M,
    VIEW_RAD,
    scan_exponent,
    share_by_fit,
    through_beam_loss,
)
from clustermcl.filter.laser.sensor_model import Beams, SensorModel, ground_log_penalty
from clustermcl.filter.log_weights import log_sum, normalised_weights
from clustermcl.filter.motion.model import move, standard_normals
from clustermcl.filter.observations.kind import NO_LANDMARKS, Kind, Landmarks
from clustermcl.filter.observations.likelihood import log_likelihood_ratio
from clustermcl.filter.poses import between, compose
from clustermcl.filter.resampling import optimal_resampling
from clustermcl.filter.search.branch_and_bound import (
    BranchAndBoundSearch,
    Circle,
    Corners,
    SearchSpace,
)
from clustermcl.filter.search.places import FoundPlace, Labels, clustered, found_places
from clustermcl.filter.settings import ClusterSettings, FilterSettings
from clustermcl.filter.slices import SLICE_WORK, Slices, WorkMeter

_REFINEMENTS = 2
"""Number of times that the leaves of branch and bound are split and scored again."""
_FOLLOWED_SHARE = 0.01
"""Least share of a place whose beams are followed, because ray casting is expensive."""
_RAY_WORK = 64
"""Cost of following a beam [look-ups]."""
_SAMPLED = 0.05
"""Share of the weight that is only a sample of the possible poses, above which everything is
searched again when the number of scans has doubled."""
_MOSTLY_SAMPLED = 0.5
"""The same share, above which the number of scans has to quadruple first."""
_SCANS_JOINED = 8
"""Largest number of scans that one search of everything uses."""
_OBSERVATIONS_KEPT = 64
_VIEW = ClusterSettings(view_distance_m=VIEW_M, view_turn_rad=VIEW_RAD)
_BLUR_M, _BLUR_RAD = 0.15, 0.05
"""Standard deviations added to observations: a pose stands for others in its part of the map."""
_POSES_TOGETHER = 64
"""Poses of a slice are a multiple of this, so that slices do not change rounding."""
_POSES_PER_PLACE, _LEAST_POSES = 50, 1000
"""Number of poses that a shard keeps for each place, and least number of poses that it keeps."""
_EVENLY = (0.8191725134, 0.6710436067, 0.5497004779)
"""Three numbers; the fractional parts of their multiples fill a cube evenly (Roberts, 2018)."""


@dataclass(frozen=True)
class _Kept:
    """Poses, each of which stands for a part of the map and of the headings around it."""

    poses: Poses
    log_weights: LogWeights
    """(N,) log of the part's share of the space, plus the tempered log-likelihood of all scans."""
    sizes: NDArray[np.float64]
    """(N,) side of the part, relative to a leaf."""

    def at(self, chosen: NDArray[np.int64]) -> "_Kept":
        return _Kept(self.poses[chosen], self.log_weights[chosen], self.sizes[chosen])


@dataclass(frozen=True)
class _PastScan:
    """A scan, and the odometry at its time."""

    odom_from_robot: Pose
    beams: Beams

    def hits_from(self, odom_from_now: Pose) -> Points:
        """Return the (B, 2) ends of the beams in the robot's present frame [m]."""
        now_from_then = between(odom_from_now, self.odom_from_robot)
        ends = np.zeros((self.beams.count, 3))
        ends[:, :2] = self.beams.hits_in_robot
        return compose(now_from_then, ends)[:, :2]


class GlobalSearch:
    """One shard of a global search.

    Raises:
        ValueError: the map has no free cell.
    """

    def __init__(
        self,
        model: SensorModel,
        settings: FilterSettings,
        shard: int,
        near: Circle | None = None,
        corners: Corners | None = None,
    ) -> None:
        self._model, self._settings, self._shard = model, settings, shard
        self._rules = rules = settings.search
        shape = model.pyramid.leaf_cells, rules.heading_step_rad, rules.shards
        # The shards and searches of a process share the leaves of the map.
        self._space = model.grid.once(
            ("search space", *shape, near, corners),
            lambda: SearchSpace(model.grid, *shape, near, corners),
        )
        self._most = max(self._rules.poses // self._rules.shards // 2, 1)
        self._wanted = self._most
        self._meter = WorkMeter()
        self._scans: list[_PastScan] = []
        """The scans for the next search of everything."""
        self._next_search = 1
        """Number of scans at which everything is searched next."""
        self._kept: _Kept | None = None
        self._observations: list[Kind] = []
        """The newest observations, relative to the present pose."""
        self._landmarks = NO_LANDMARKS
        self._labels: Labels = np.empty(0, np.int32)
        self._sampled = 1.0
        """Share of the weight that was only a sample, at the last search of everything."""
        self.log_evidence = 0.0
        """Log of the average likelihood of all scans over the shard's part of the space."""

    def use(self, model: SensorModel, settings: FilterSettings) -> None:
        """Use another model of the same map and other settings from the next step on."""
        self._model, self._settings = model, settings

    @property
    def left_out_gap(self) -> float:
        """Lower bound of the log ratio of the kept weight to the weight left out [nat].

        It is the smaller of two bounds: the log ratio of all weight to the sampled weight, and the
        margin of the search.
        """
        return min(-math.log(max(self._sampled, 1e-300)), self._rules.margin)

    @property
    def poses(self) -> int:
        return 0 if self._kept is None else len(self._kept.poses)

    def advance(
        self,
        odom_from_before: Pose | None,
        odom_from_after: Pose,
        beams: Beams,
        rng: np.random.Generator,
        observed: tuple[Sequence[Kind], Landmarks] = ((), NO_LANDMARKS),
    ) -> Slices[None]:
        """Apply one step, in slices.

        The (3,) odometry at the step before is None at the first step.
        """
        rules, motion = self._settings, np.zeros(3)
        if odom_from_before is not None:
            motion = between(odom_from_before, odom_from_after)
        new, landmarks = observed
        self._landmarks = landmarks if new else self._landmarks
        earlier = [each.moved(motion) for each in self._observations]
        self._observations = [*earlier, *new][-_OBSERVATIONS_KEPT:]
        new_view = 1.0 if rules.belief.piece_evidence == 0.0 else new_share(motion, _VIEW)
        if len(beams.ranges) and self._sampled > _SAMPLED:
            self._scans.append(_PastScan(odom_from_after, beams))
            if len(self._scans) == self._next_search:
                yield from self._search(rng)
                return
        if self._kept is None:
            return
        if odom_from_before is None:
            raise ValueError("the odometry of the step before is missing")
        kept = self._split(self._kept, rng)[0] if beams.count else self._kept
        yield
        noise = standard_normals(rng, 3, len(kept.poses))
        moved = move(kept.poses, motion, self._settings.motion, noise)
        self._kept = replace(kept, poses=moved)
        if beams.count == 0:
            return
        yield
        yield from self._weigh(self._kept, beams, new_view, rng, new)

    def places(self, rng: np.random.Generator) -> Slices[list[FoundPlace]]:
        """Return the places of the last step, the most probable first, in slices."""
        if self._kept is None:
            return []
        particles = ParticleSet(self._kept.poses, self._kept.log_weights)
        return (yield from found_places(particles, self._labels, self._settings, rng))

    def _search(self, rng: np.random.Generator) -> Slices[None]:
        """Search the whole space by all scans, in slices."""
        now = self._scans[-1]
        hits = np.concatenate([past.hits_from(now.odom_from_robot) for past in self._scans])
        grid = BranchAndBoundSearch(self._model, self._space, hits, self._shard, self._rules, rng)
        yield from grid.slices()
        leaves = grid.leaves()
        self._sampled, scores = leaves.sampled, leaves.scores
        times = 4 if self._sampled > _MOSTLY_SAMPLED else 2
        self._next_search = min(times * len(self._scans), _SCANS_JOINED)
        kept = _Kept(leaves.map_from_robot, leaves.log_weights, np.ones(len(scores)))
        self._wanted = self._most
        for _ in range(_REFINEMENTS):
            yield
            kept, chosen = yield from self._thin(kept, rng)
            yield
            kept, parent = self._split(kept, rng, also_unsplit=True)
            yield
            # The sides of leaves may lie in walls, where no robot can be.
            is_free = ground_log_penalty(kept.poses, self._model.grid, -1.0) == 0.0
            free = np.flatnonzero(is_free)
            kept, parent = kept.at(free), parent[free]
            before = kept.log_weights - scores[chosen][parent]
            yield
            scores = yield from self._scores(kept.poses, now)
            kept = replace(kept, log_weights=before + scores)
        log_weights = self._observed(kept.poses, kept.log_weights, self._observations)
        kept = replace(kept, log_weights=log_weights)
        yield
        kept, _ = yield from self._thin(kept, rng)
        yield from self._settle(kept, now.beams)

    def _scores(self, poses: Poses, now: "_PastScan") -> Slices[LogWeights]:
        """Return (N,) log-likelihoods of all scans at present poses."""
        total = np.zeros(len(poses))
        for past in self._scans:
            now_from_then = between(now.odom_from_robot, past.odom_from_robot)
            fits = yield from self._fits(poses, past.beams, now_from_then)
            total += scan_exponent(past.beams.count, self._model.settings) * fits
        return total

    def _fits(self, poses: Poses, beams: Beams, at_scan: Pose | None = None) -> Slices[LogWeights]:
        """Return (N,) log-likelihoods of a scan at poses, or at `at_scan` relative to each pose."""
        some = max(SLICE_WORK // beams.count // _POSES_TOGETHER, 1) * _POSES_TOGETHER
        parts = []
        for first in range(0, len(poses), some):
            part = poses[first : first + some]
            at = part if at_scan is None else compose(part, at_scan)
            parts.append(self._model.log_likelihood(at, beams))
            yield from self._meter.spend(len(part) * beams.count)
        return np.concatenate(parts)

    def _weigh(
        self,
        kept: _Kept,
        beams: Beams,
        new_view: float,
        rng: np.random.Generator,
        new: Sequence[Kind],
    ) -> Slices[None]:
        """Weigh poses by a further scan, in slices.

        The likelihood is tempered for the weights of the poses, but not for the evidence.
        """
        fits = yield from self._fits(kept.poses, beams)
        not_free = self._model.settings.not_free_log_penalty
        penalty = ground_log_penalty(kept.poses, self._model.grid, not_free)
        gain = scan_exponent(beams.count, self._model.settings) * fits + penalty
        likelihood = log_sum(kept.log_weights + gain)
        share = new_view
        if self._settings.belief.piece_evidence > 0.0:
            per_beam = float(fits.max()) / beams.count
            share *= share_by_fit(per_beam, self._model.settings) ** 2
        log_weights = kept.log_weights + share * gain
        log_weights += likelihood - log_sum(log_weights)
        log_weights = self._observed(kept.poses, log_weights, new)
        yield
        kept, _ = yield from self._thin(replace(kept, log_weights=log_weights), rng)
        yield from self._settle(kept, beams, new_view)

    def _observed(
        self, poses: Poses, log_weights: LogWeights, observations: Sequence[Kind]
    ) -> LogWeights:
        if not observations:
            return log_weights
        blurred = [each.blurred(_BLUR_M, _BLUR_RAD) for each in observations]
        ratios = log_likelihood_ratio(poses, blurred, self._landmarks, self._model.grid)
        return log_weights + ratios

    def _split(
        self, kept: _Kept, rng: np.random.Generator, *, also_unsplit: bool = False
    ) -> tuple[_Kept, NDArray[np.int64]]:
        """Split heavy poses; the total weight and the covered space stay.

        With `also_unsplit`, the others move, too. Also return the index of each one's origin.
        """
        copies = np.ceil(self._wanted * normalised_weights(kept.log_weights))
        poses, log_weights, sizes, parent = _spread(
            (kept.poses, kept.log_weights, kept.sizes),
            np.maximum(copies, 1.0).astype(np.int64),
            self._space.cell,
            rng.random(3),
            not also_unsplit,
        )
        return _Kept(poses, log_weights, sizes), parent

    def _thin(
        self, kept: _Kept, rng: np.random.Generator
    ) -> Slices[tuple[_Kept, NDArray[np.int64]]]:
        """Resample to the wanted number; also return the (N,) indices of the chosen poses."""
        chosen, log_weights = yield from optimal_resampling(kept.log_weights, self._wanted, rng)
        return replace(kept.at(chosen), log_weights=log_weights), chosen

    def _settle(self, kept: _Kept, beams: Beams, new_view: float = 1.0) -> Slices[None]:
        """Find the places after a scan, and take from each what it explains through walls."""
        yield
        labels, count = clustered(kept.poses, kept.log_weights, self._rules)
        weights = normalised_weights(kept.log_weights)
        shares = np.bincount(labels + 1, weights, minlength=count + 1)[1:].astype(np.float64)
        lost = yield from self._through_walls(kept, labels, shares, beams)
        self.log_evidence = log_sum(kept.log_weights - lost)
        log_weights = kept.log_weights - new_view * lost
        log_weights += self.log_evidence - log_sum(log_weights)
        self._kept, self._labels = replace(kept, log_weights=log_weights), labels
        places = int(np.count_nonzero(shares >= self._settings.belief.least_probability))
        self._wanted = min(max(_POSES_PER_PLACE * places, _LEAST_POSES), self._most)

    def _through_walls(
        self, kept: _Kept, labels: Labels, shares: NDArray[np.float64], beams: Beams
    ) -> Slices[LogWeights]:
        """Return what (N,) poses lose, because beams through walls fit at their place [nat]."""
        lost, settings = np.zeros(len(shares) + 1), self._model.settings
        if self._settings.belief.piece_evidence == 0.0:
            return lost[labels]
        best = np.zeros(len(shares) + 1, np.int64)  # the last is of poses without a place
        order = np.argsort(kept.log_weights, kind="stable")
        best[labels[order]] = order
        for place in np.flatnonzero(shares >= _FOLLOWED_SHARE):
            pose = kept.poses[best[place]]
            fits, through = decoded(beam_fits(pose, beams, self._model, mirrored=False))
            explained = through_beam_loss(settings) * float(fits @ through)
            lost[place] = THROUGH_WEIGHT * scan_exponent(beams.count, settings) * explained
            yield from self._meter.spend(_RAY_WORK * beams.count)
        return lost[labels]


@kernel
def _spread(
    kept: tuple[Poses, LogWeights, NDArray[np.float64]],
    copies: NDArray[np.int64],
    cell: NDArray[np.float64],
    start: NDArray[np.float64],
    lone_stay: bool,
) -> tuple[Poses, LogWeights, NDArray[np.float64], NDArray[np.int64]]:
    poses, log_weights, sizes = kept
    count, made = copies.sum(), 0
    parts, logs = np.empty((count, 3)), np.empty(count)
    sides, parent = np.empty(count), np.empty(count, np.int64)
    for i in range(len(copies)):
        stays = lone_stay and copies[i] == 1
        for number in range(copies[i]):
            for axis in range(3):
                across = number * _EVENLY[axis] + start[axis]
                offset = (across - floor(across) - 0.5) * cell[axis] * sizes[i]
                parts[made, axis] = poses[i, axis] + (0.0 if stays else offset)
            logs[made] = log_weights[i] - log(copies[i])
            sides[made] = sizes[i] * copies[i] ** (-1.0 / 3.0)
            parent[made] = i
            made += 1
    return parts, logs, sides, parent
