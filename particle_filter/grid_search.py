"""Every place of a map and every heading, scored for one scan: coarse to fine, with a bound.

The free space is covered by a grid of leaves (0.2 m, 2 degrees). Blocks of four leaves with one
heading are bounded first (`pooled_field.py`); only leaves of blocks whose bound comes within a
margin of the best leaf are scored. What is left out is worse than the best by the margin, or, where
more is as good than can be kept, by what is told.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import FREE, Cells, LogWeights, Poses
from particle_filter.pooled_field import MOST_BEAMS
from particle_filter.poses import TURN, compose
from particle_filter.sensor_model import Beams, Grid, SensorModel
from particle_filter.settings import SearchSettings

_DOWN, _ACROSS = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
"""The rows and columns of a block's leaves."""
_LARGEST_GAP = 16
"""Blocks between two free ones in a row that are bounded with them: one long run is faster."""
_BLOCKS_PER_POSE = 4
_BATCH = 4096
"""Blocks whose leaves are scored together."""


class SearchSpace:
    """The leaves of a map: where they lie, and the blocks that they belong to.

    Args:
        grid: the map.
        side: of a block [cells].
        heading_step_rad: at most so far from one heading to the next.
        shards: the headings are dealt out to so many.

    Raises:
        ValueError: the map has no free cell.
    """

    def __init__(self, grid: Grid, side: int, heading_step_rad: float, shards: int) -> None:
        self._grid, self._leaf_cells = grid, side // 2
        self._free, free_cells = _free_leaves(grid.cells, side // 2)
        if free_cells == 0:
            raise ValueError("the map has no free cell to search")
        self.runs, self.usable = _runs(np.asarray(self._free.any(axis=-1)))
        self._first = np.cumsum(self.runs[:, 2]) - self.runs[:, 2]
        per_shard = math.ceil(TURN / heading_step_rad / shards)
        self.headings = np.arange(per_shard * shards) * (TURN / (per_shard * shards)) - math.pi
        self.leaf_count = free_cells / self._leaf_cells**2 * per_shard
        """So many leaves would be a shard's part of the free space, if none reached into walls."""

    @property
    def cell(self) -> NDArray[np.float64]:
        """(3,) size of a leaf [m, m, rad]."""
        leaf_m = self._leaf_cells * self._grid.cell_m
        return np.array([leaf_m, leaf_m, TURN / len(self.headings)])

    def leaves(self, blocks: NDArray[np.int64], headings: NDArray[np.int64]) -> Poses:
        """Middles of the leaves of some blocks that hold free cells, each with one heading."""
        run = np.searchsorted(self._first, blocks, side="right") - 1
        rows = self.runs[run, 0]
        cols = self.runs[run, 1] + blocks - self._first[run]
        block, leaf = np.nonzero(self._free[rows, cols])
        leaf_m = self._leaf_cells * self._grid.cell_m
        in_grid = np.empty((len(block), 3))
        in_grid[:, 0] = (2 * cols[block] + _ACROSS[leaf] + 0.5) * leaf_m
        in_grid[:, 1] = (2 * rows[block] + _DOWN[leaf] + 0.5) * leaf_m
        in_grid[:, 2] = self.headings[headings[block]]
        return compose(self._grid.map_from_grid, in_grid)


@dataclass(frozen=True)
class Leaves:
    """What a shard of a grid search has found."""

    map_from_robot: Poses
    scores: LogWeights
    """(N,) log-likelihoods with the exponent."""
    left_out: float
    """No other leaf of the shard has a higher one than this."""
    log_likelihood_per_beam: float
    """Of the best leaf, without the exponent."""


class GridSearch:
    """One shard's part of a scan's search: `advance` until it is done, then ask for `leaves`.

    Args:
        model: scores leaves; of models without a bound the pooled field is a guide only.
        space: where to look.
        beams: the scan; at least one beam returned.
        shard: takes every so many-th heading.
        settings: margin and numbers.
    """

    def __init__(
        self,
        model: SensorModel,
        space: SearchSpace,
        beams: Beams,
        shard: int,
        settings: SearchSettings,
    ) -> None:
        self._model, self._space, self._beams = model, space, beams
        self._exponent = model.settings.scan_likelihood_exponent
        self._margin = settings.margin
        self._most_blocks = max(_BLOCKS_PER_POSE * settings.poses // settings.shards, 1)
        self._headings = np.arange(shard, len(space.headings), settings.shards)
        self._done = 0
        self._hits = _thinned(beams)
        self._sums = np.zeros(len(space.usable), np.uint16)
        self._blocks = _Blocks.none()
        self._waiting: list[_Blocks] = []
        self._best = self._left_out = -math.inf
        self._reference = -math.inf
        """Blocks must come within the margin of it."""

    @property
    def progress(self) -> float:
        """From 0 to 1; what comes after the last heading takes no longer than the rest."""
        return self._done / len(self._headings)

    def advance(self) -> bool:
        """Bound all blocks with one more heading; whether there is one left."""
        index = int(self._headings[self._done])
        sums, usable = self._bounded(float(self._space.headings[index])), self._space.usable
        best = int(np.argmax(np.where(usable, sums, 0)))
        if usable[best] and self._bound(sums[best]) > self._reference:
            self._score(np.array([best]), np.array([index]))
            if not self._model.is_bounded:
                self._reference = self._bound(sums[best])
        kept = np.flatnonzero(usable & (sums >= self._least_sum()))
        headings = np.full(len(kept), index, np.int64)
        self._waiting.append(_Blocks(kept, headings, sums[kept]))
        if sum(len(some.sums) for some in self._waiting) > self._most_blocks:
            self._sift()
        self._done += 1
        return self._done < len(self._headings)

    def leaves(self) -> Leaves:
        """All leaves within the margin of the best, of the blocks that could be kept."""
        self._sift()
        blocks = self._blocks
        order = np.argsort(-blocks.sums.astype(np.int64), kind="stable")
        found = []
        for start in range(0, len(order), _BATCH):
            batch = order[start : start + _BATCH]
            batch = batch[blocks.sums[batch] >= self._least_sum()]
            if len(batch) == 0:
                break
            found.append(self._score(blocks.blocks[batch], blocks.headings[batch]))
        poses, scores = (np.concatenate(part) for part in zip(*found, strict=True))
        inside = scores >= self._best - self._margin
        left_out = max(self._left_out, self._best - self._margin)
        per_beam = self._best / self._exponent / self._beams.count
        return Leaves(poses[inside], scores[inside], left_out, per_beam)

    def _bounded(self, heading: float) -> NDArray[np.uint16]:
        cos, sin = math.cos(heading), math.sin(heading)
        cells_per_m = 1.0 / self._model.grid.cell_m
        x, y = self._hits[:, 0] * cells_per_m, self._hits[:, 1] * cells_per_m
        offsets = np.stack([sin * x + cos * y, cos * x - sin * y], axis=-1)
        whole = np.floor(offsets).astype(np.int64)
        self._model.pooled.bounds(whole, self._space.runs, self._sums)
        return self._sums

    def _bound(self, sum_of_steps: int) -> float:
        """The highest score that a sum of steps allows."""
        pooled, count = self._model.pooled, len(self._hits)
        return self._scale() * (count * pooled.log_floor + pooled.log_step * int(sum_of_steps))

    def _scale(self) -> float:
        """Of a scan with too many beams only some are bounded, in the stead of all."""
        return self._exponent * self._beams.count / len(self._hits)

    def _least_sum(self) -> int:
        """Sums of steps below this are worse than the best leaf by more than the margin."""
        pooled, count = self._model.pooled, len(self._hits)
        least = (self._reference - self._margin) / self._scale() - count * pooled.log_floor
        return max(math.floor(least / pooled.log_step), 0)

    def _score(
        self, blocks: NDArray[np.int64], headings: NDArray[np.int64]
    ) -> tuple[Poses, LogWeights]:
        poses = self._space.leaves(blocks, headings)
        scores = self._exponent * self._model.log_likelihood(poses, self._beams)
        self._best = max(self._best, float(scores.max()))
        if self._model.is_bounded:
            self._reference = self._best
        return poses, scores

    def _sift(self) -> None:
        """Keep the blocks that are still good enough; of too many, those with the best bounds."""
        joined = _Blocks.joined([self._blocks, *self._waiting])
        self._waiting = []
        good = np.flatnonzero(joined.sums >= self._least_sum())
        if len(good) > self._most_blocks:
            good = good[np.argsort(-joined.sums[good].astype(np.int64), kind="stable")]
            cut = self._bound(joined.sums[good[self._most_blocks]])
            self._left_out = max(self._left_out, cut)
            good = np.sort(good[: self._most_blocks])
        self._blocks = joined.at(good)


@dataclass(frozen=True)
class _Blocks:
    """Blocks with a heading each, and the sums of steps that bound them."""

    blocks: NDArray[np.int64]
    headings: NDArray[np.int64]
    sums: NDArray[np.uint16]

    @classmethod
    def none(cls) -> "_Blocks":
        return cls(np.empty(0, np.int64), np.empty(0, np.int64), np.empty(0, np.uint16))

    @classmethod
    def joined(cls, some: "list[_Blocks]") -> "_Blocks":
        return cls(
            np.concatenate([part.blocks for part in some]),
            np.concatenate([part.headings for part in some]),
            np.concatenate([part.sums for part in some]),
        )

    def at(self, chosen: NDArray[np.int64]) -> "_Blocks":
        return _Blocks(self.blocks[chosen], self.headings[chosen], self.sums[chosen])


def _free_leaves(cells: Cells, leaf: int) -> tuple[NDArray[np.bool_], int]:
    """(block rows, block cols, 4) whether a leaf holds a free cell; and how many free cells are."""
    rows, cols = (-(-size // (2 * leaf)) for size in cells.shape)
    free, count = np.zeros((rows, cols, 4), bool), 0
    for row in range(rows):  # a row at a time: a map may be a quarter of a gigabyte
        strip = np.zeros((2 * leaf, 2 * leaf * cols), bool)
        at = cells[2 * leaf * row : 2 * leaf * (row + 1)] == FREE
        strip[: at.shape[0], : at.shape[1]] = at
        count += int(np.count_nonzero(at))
        parts = np.asarray(strip.reshape(2, leaf, cols, 2, leaf).any(axis=(1, 4)))
        free[row] = parts.transpose(1, 0, 2).reshape(cols, 4)
    return free, count


def _runs(usable: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Runs of blocks side by side, and which blocks of them are usable."""
    runs = []
    for row in np.flatnonzero(usable.any(axis=1)):
        cols = np.flatnonzero(usable[row])
        breaks = np.flatnonzero(np.diff(cols) > _LARGEST_GAP)
        firsts = cols[np.concatenate([[0], breaks + 1])]
        lasts = cols[np.concatenate([breaks, [len(cols) - 1]])]
        runs += [(row, first, last - first + 1) for first, last in zip(firsts, lasts, strict=True)]
    inside = [usable[row, first : first + count] for row, first, count in runs]
    return np.array(runs, np.int64), np.concatenate(inside)


def informative(beams: Beams) -> bool:
    """Whether a scan tells where to look: at least one beam returned."""
    return bool((beams.ranges < beams.max_range_m).any())


def _thinned(beams: Beams) -> NDArray[np.float64]:
    """(B, 2) ends of the beams that returned, evenly thinned to what can be summed."""
    hits = beams.hits_in_robot[beams.ranges < beams.max_range_m]
    return hits[:: -(-len(hits) // MOST_BEAMS)]
