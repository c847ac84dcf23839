"""Searches all poses of a map for those that fit a scan, by branch and bound.

A grid of leaves (0.2 m, 2 degrees) covers the free space. For each heading, the score of a tile of
many leaves is bounded from above (`pyramid.py`). Tiles whose bound is worse than the best leaf by
more than a margin are excluded; the others are split into tiles of half the width, down to leaves,
which have exact scores. If more leaves remain than can be kept, optimal resampling keeps some.

References:
    Olson, "Real-time correlative scan matching" (2009); Hess et al., "Real-time loop closure in 2D
    lidar SLAM" (2016), algorithm 3. Unlike these, it returns all good poses, not only the best.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, LogWeights, Points, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import kernel
from clustermcl.filter.laser.evidence_model import scan_exponent
from clustermcl.filter.laser.pyramid import LEVELS, MOST_BEAMS, Level, Runs, Sums, sum_steps
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.filter.log_weights import normalised_weights
from clustermcl.filter.poses import between, compose
from clustermcl.filter.resampling import optimal_resampling
from clustermcl.filter.settings import SearchSettings
from clustermcl.filter.slices import SLICE_WORK, Slices, WorkMeter

_LARGEST_GAP = 48
"""Largest gap between two good tiles that is scored too, as one long run is faster [tiles]."""
_WAITING, _SIFTED = 8, 2
"""Multiples of the leaves to keep: above the first, waiting leaves are resampled to the second."""
_TILES_OF_BAND = 8000
"""Approximate size of a band of the map, whose bounds decide which is searched first [tiles]."""
_LEAVES_OF_TILE = 4 ** (LEVELS - 1)
_BOUND_BELOW = 0.03
"""Share of good leaves in the last band above which bounds exclude little and are skipped."""
_SUMS_PER_LOOKUP = 4
"""Least number of additions of rows in the time of one table look-up."""
_SUMS_OF_PART = SLICE_WORK * _SUMS_PER_LOOKUP // 2
"""Number of additions between two checks for the end of a slice."""


Circle: TypeAlias = tuple[float, float, float]
"""x [m], y [m], radius [m] in the map."""
Corners: TypeAlias = tuple[tuple[float, float], tuple[float, float]]
"""x [m], y [m] of the lowest and the highest corner of a rectangle in the map."""


class SearchSpace:
    """The leaves of a map, or of a part of it: positions, headings, and which hold a free cell.

    The headings, at most `heading_step_rad` apart, are shared by the shards. A circle `near` or a
    rectangle without a free leaf is ignored; the rectangle is of a grid that is not turned.

    Raises:
        ValueError: the map has no free cell.
    """

    def __init__(
        self,
        grid: Grid,
        leaf_cells: int,
        heading_step_rad: float,
        shards: int,
        near: Circle | None = None,
        corners: Corners | None = None,
    ) -> None:
        free, free_cells = free_leaves(grid, leaf_cells)
        if free_cells == 0:
            raise ValueError("the map has no free cell to search")
        leaf_m, all_leaves = leaf_cells * grid.cell_m, np.count_nonzero(free)
        tiles = free.shape, leaf_m, grid.map_from_grid
        for part in (
            None if corners is None else _in_rectangle(corners, *tiles),
            None if near is None else _in_circle(near, *tiles),
        ):
            if part is not None and (inside := free & part).any():
                free = inside
        self.free = [free]
        """For each level, coarse to fine: (rows, cols) whether a tile holds a free cell."""
        for _ in range(LEVELS - 1):
            low, high = self.free[0][::2], self.free[0][1::2]
            self.free.insert(0, low[:, ::2] | high[:, ::2] | low[:, 1::2] | high[:, 1::2])
        every = np.array([(row, 0, self.free[0].shape[1]) for row in range(len(self.free[0]))])
        self.runs = _joined_runs(every, self.free[0].reshape(-1))
        """Runs of adjacent tiles that cover all free tiles; they also cover small gaps."""
        per_shard = math.ceil(math.tau / heading_step_rad / shards)
        self.headings = np.arange(per_shard * shards) * (math.tau / (per_shard * shards)) - math.pi
        self._map_from_grid, self._leaf_m = grid.map_from_grid, leaf_m
        share = np.count_nonzero(free) / all_leaves
        self.leaf_count = share * free_cells / leaf_cells**2 * per_shard
        """Size of a shard's free space [leaves]."""

    @property
    def cell(self) -> NDArray[np.float64]:
        """(3,) size of a leaf [m, m, rad]."""
        return np.array([self._leaf_m, self._leaf_m, math.tau / len(self.headings)])

    def poses(self, leaves: NDArray[np.int32], headings: NDArray[np.int32]) -> Poses:
        """Return (N, 3) centres of leaves, numbered row by row, with their headings."""
        rows, cols = np.divmod(leaves, self.free[-1].shape[1])
        in_grid = np.empty((len(leaves), 3))
        in_grid[:, 0] = (cols + 0.5) * self._leaf_m
        in_grid[:, 1] = (rows + 0.5) * self._leaf_m
        in_grid[:, 2] = self.headings[headings]
        return compose(self._map_from_grid, in_grid)


class _Found(NamedTuple):
    """Columns of the leaves within the margin of the best one so far."""

    leaves: NDArray[np.int32]
    headings: NDArray[np.int32]
    sums: Sums
    log_worth: LogWeights
    """(N,) log of the number of leaves that a leaf stands for."""

    def at(self, chosen: NDArray[np.int64]) -> "_Found":
        return _Found(
            self.leaves[chosen], self.headings[chosen], self.sums[chosen], self.log_worth[chosen]
        )


@dataclass(frozen=True)
class Leaves:
    """The good leaves of one shard."""

    map_from_robot: Poses
    log_weights: LogWeights
    """(N,) log of a leaf's share of the shard's space, plus its log-likelihood."""
    scores: LogWeights
    """(N,) log-likelihoods with the exponent."""
    sampled: float
    """Share of the weight that belongs to leaves which also stand for others."""


class BranchAndBoundSearch:
    """The search of one shard; exhaust `slices`, then call `leaves`.

    At least one of the (B, 2) beams [m] returned. Each of n shards searches every n-th heading.
    """

    def __init__(
        self,
        model: SensorModel,
        space: SearchSpace,
        hits_in_robot: Points,
        shard: int,
        settings: SearchSettings,
        rng: np.random.Generator,
    ) -> None:
        self._pyramid, self._space, self._rng = model.pyramid, space, rng
        self._hits = hits_in_robot[:: -(-len(hits_in_robot) // MOST_BEAMS)] / model.grid.cell_m
        exponent = scan_exponent(len(hits_in_robot), model.settings)
        self._scale = exponent * len(hits_in_robot) / len(self._hits)
        """Factor from the sum of scored beams to the log-likelihood of the scan; if there are too
        many beams, a scored beam stands for several."""
        self._margin = math.ceil(settings.margin / (self._scale * self._pyramid.log_step))
        self._most = max(settings.poses // settings.shards, 1)
        headings = range(shard, len(space.headings), settings.shards)
        self._offsets = {heading: self._offsets_at(heading) for heading in headings}
        self._best, self._good_share = 0, 0.0
        self._found: list[_Found] = []
        """The leaves that `_sift` kept, and those found since."""
        self._new_count = 0
        self._meter = WorkMeter()

    def slices(self) -> Iterator[None]:
        """Search, in slices.

        A part is a band of the map with one heading. Parts are searched in the order of their
        bounds, best first: a good leaf that is found early excludes many others.
        """
        bands = _parts(self._space.runs, _TILES_OF_BAND)
        headings, bounds = list(self._offsets), list[int]()
        for offsets in self._offsets.values():
            for band in bands:
                sums = yield from self._sums(self._pyramid.levels[0], offsets, band)
                bounds.append(sums.max(initial=0))
        for part in np.argsort(bounds, kind="stable")[::-1].tolist():
            if bounds[part] < self._least():
                break
            heading, at = divmod(part, len(bands))
            yield from self._search(headings[heading], bands[at])
        yield from self._sift(self._most)

    def _sums(self, level: Level, offsets: NDArray[np.int64], runs: Runs) -> Slices[Sums]:
        """Bound the scores of tiles at one level, in slices."""
        parts = []
        for part in _parts(runs, _SUMS_OF_PART // len(offsets)):
            parts.append(sum_steps(level, offsets, part))
            yield from self._meter.spend(len(parts[-1]) * len(offsets) // _SUMS_PER_LOOKUP)
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _search(self, heading: int, runs: Runs) -> Iterator[None]:
        offsets, leaves = self._offsets[heading], int(runs[:, 2].sum()) * _LEAVES_OF_TILE
        for level, free in zip(self._pyramid.levels[:-1], self._space.free[:-1], strict=True):
            if self._good_share < _BOUND_BELOW:
                sums = yield from self._sums(level, offsets, runs)
                runs = _joined_runs(runs, _free_and_good(runs, sums, free, self._least()))
            runs = _halved(runs)
        sums = yield from self._sums(self._pyramid.levels[-1], offsets, runs)
        free = self._space.free[-1]
        self._best = max(self._best, _best(runs, sums, free))
        good, kept = _good(runs, sums, free, self._least())
        self._good_share = len(good) / leaves
        headings = np.full(len(good), heading, np.int32)
        self._found.append(_Found(good, headings, kept, np.zeros(len(good))))
        self._new_count += len(good)
        if self._new_count > _WAITING * self._most:
            yield from self._sift(_SIFTED * self._most)

    def leaves(self) -> Leaves:
        """Return the leaves within the margin of the best one, or a weighted sample of them."""
        (found,) = self._found
        floor = self._scale * len(self._hits) * self._pyramid.log_floor
        scores = np.asarray(floor + self._scale * self._pyramid.log_step * found.sums)
        log_weights = scores + found.log_worth
        sampled = normalised_weights(log_weights)[found.log_worth > 0.0].sum()
        return Leaves(
            self._space.poses(found.leaves, found.headings),
            log_weights - math.log(self._space.leaf_count),
            scores,
            float(sampled),
        )

    def _offsets_at(self, heading: int) -> NDArray[np.int64]:
        """Return (B, 2) offsets from the robot to the ends of beams, rounded down [cells]."""
        angle = float(self._space.headings[heading])
        cos, sin = math.cos(angle), math.sin(angle)
        x, y = self._hits[:, 0], self._hits[:, 1]
        return np.floor(np.stack([sin * x + cos * y, cos * x - sin * y], axis=-1)).astype(np.int64)

    def _least(self) -> int:
        """Return the lowest sum that is within the margin of the best."""
        return max(self._best - self._margin, 0)

    def _sift(self, count: int) -> Iterator[None]:
        """Keep at most `count` of the leaves that are within the margin of the best one."""
        yield
        found = _Found(*map(np.concatenate, zip(*self._found, strict=True)))
        self._found, self._new_count = [], 0
        yield
        found = found.at(np.flatnonzero(found.sums >= self._least()))
        yield
        scores = self._scale * self._pyramid.log_step * found.sums
        chosen, log_weights = yield from optimal_resampling(
            scores + found.log_worth, count, self._rng
        )
        log_worth = log_weights - scores[chosen]
        self._found = [found.at(chosen)._replace(log_worth=log_worth)]
        yield


def free_leaves(grid: Grid, leaf: int) -> tuple[NDArray[np.bool_], int]:
    """Find the leaves that hold a free cell, and count free cells.

    A large map takes seconds; the grid keeps the result.

    Returns:
        (rows, cols) whether each leaf holds a free cell, padded to whole tiles of the first level;
        and the number of free cells.
    """

    def compute() -> tuple[NDArray[np.bool_], int]:
        # As unsigned numbers, free cells are the smallest: no array of the map's size is needed.
        least, cells = grid.cells.view(np.uint8), grid.cells
        for axis, size in enumerate(cells.shape):
            least = np.minimum.reduceat(least, np.arange(0, size, leaf), axis=axis)
        whole = 2 ** (LEVELS - 1)
        free = np.pad(least == FREE, [(0, -size % whole) for size in least.shape])
        return free, cells.size - int(np.count_nonzero(cells))

    return grid.once(("free leaves", leaf), compute)


def _in_circle(
    near: Circle, shape: tuple[int, ...], leaf_m: float, map_from_grid: Pose
) -> NDArray[np.bool_]:
    """Return (rows, cols) whether the centre of each leaf lies in a circle of the map."""
    x, y, _ = between(map_from_grid, np.array([near[0], near[1], 0.0]))
    down = (np.arange(shape[0]) + 0.5) * leaf_m - y
    across = (np.arange(shape[1]) + 0.5) * leaf_m - x
    return np.asarray(down[:, None] ** 2 + across**2 <= near[2] ** 2)


def _in_rectangle(
    corners: Corners, shape: tuple[int, ...], leaf_m: float, map_from_grid: Pose
) -> NDArray[np.bool_]:
    """Return (rows, cols) whether the centre of each leaf lies in a rectangle of the map."""
    (left, low), (right, high) = np.array(corners) - map_from_grid[:2]
    y, x = ((np.arange(count) + 0.5) * leaf_m for count in shape)
    return np.asarray(((low <= y) & (y < high))[:, None] & (left <= x) & (x < right))


def _parts(runs: Runs, tiles: int) -> list[Runs]:
    """Divide runs into lists of about `tiles` tiles."""
    if runs[:, 2].sum() < max(tiles, 1):
        return [runs]
    part = np.cumsum(runs[:, 2]) // max(tiles, 1)
    borders = [0, *(np.flatnonzero(np.diff(part)) + 1).tolist(), len(runs)]
    return [runs[first:last] for first, last in pairwise(borders)]


def _halved(coarse: Runs) -> Runs:
    """Return runs of the next finer level that cover the same area."""
    finer = np.repeat(2 * coarse, 2, axis=0)
    finer[1::2, 0] += 1
    return finer


@kernel
def _free_and_good(
    runs: Runs, sums: NDArray[np.uint16], free: NDArray[np.bool_], least: int
) -> NDArray[np.bool_]:
    good, start, needed = np.empty(len(sums), np.bool_), np.uint64(0), np.uint16(least)
    flat = free.reshape(-1)
    for run in range(len(runs)):
        row, first, count = runs[run]
        # Without branches and signed indices, the loop is compiled to vector instructions.
        begin, number = np.uint64(row * free.shape[1] + first), np.uint64(count)
        for i in range(number):
            good[start + i] = (sums[start + i] >= needed) & flat[begin + i]
        start += number
    return good


@kernel
def _joined_runs(runs: Runs, good: NDArray[np.bool_]) -> Runs:
    """Return runs that hold all good tiles, and small gaps between them."""
    joined = np.empty((np.count_nonzero(good), 3), np.int64)
    found, start = 0, 0
    for run in range(len(runs)):
        row, first, count = runs[run]
        last = -1  # the last good tile of the present run
        for i in range(count):
            if not good[start + i]:
                continue
            if last < 0 or i - last > _LARGEST_GAP:
                joined[found, 0], joined[found, 1] = row, first + i
                found += 1
            last = i
            joined[found - 1, 2] = first + i + 1 - joined[found - 1, 1]
        start += count
    return joined[:found].copy()


@kernel
def _best(runs: Runs, sums: NDArray[np.uint16], free: NDArray[np.bool_]) -> int:
    best, nothing, start = np.uint16(0), np.uint16(0), np.uint64(0)
    flat = free.reshape(-1)
    for run in range(len(runs)):
        row, first, count = runs[run]
        begin, number = np.uint64(row * free.shape[1] + first), np.uint64(count)
        for i in range(number):
            best = max(best, sums[start + i] if flat[begin + i] else nothing)
        start += number
    return int(best)


@kernel
def _good(
    runs: Runs, sums: NDArray[np.uint16], free: NDArray[np.bool_], least: int
) -> tuple[NDArray[np.int32], Sums]:
    """Return the free leaves with at least the sum `least`, numbered row by row, and their sums."""
    good = _free_and_good(runs, sums, free, least)
    count_good = np.count_nonzero(good)
    leaves, kept = np.empty(count_good, np.int32), np.empty(count_good, np.uint16)
    found, start = 0, 0
    for run in range(len(runs)):
        row, first, count = runs[run]
        for i in range(count):
            if good[start + i]:
                leaves[found] = row * free.shape[1] + first + i
                kept[found] = sums[start + i]
                found += 1
        start += count
    return leaves, kept
