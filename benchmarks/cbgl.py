"""The idea of CBGL (Filotheou 2023, arXiv 2307.14247), for comparison with our search.

Poses are spread over the free space at random, 40 positions a square metre with 32 headings each,
and ranked by the cumulative absolute error per ray: the sum of the differences between the ranges
that were measured and those that the map would give from there. The best ones are refined and
ranked again. CBGL refines by matching scans; here the error itself is made smaller, from finer and
finer steps around a pose. Ours, to be fair: a position is cast once, all around, for all headings.
"""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clustermcl.belief.overlaps import merge_overlapping
from clustermcl.filter.arrays import FREE, Poses
from clustermcl.filter.kernels.compiled import kernel
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.poses import compose, inverse
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap

POSITIONS_PER_M2, HEADINGS = 40.0, 32
"""As in the paper's experiments."""
_RAYS = 96
"""All around: three to a heading."""
_ROUNDS, _TRIES = 8, 64
_REFINED_PER_PLACE = 16
_BLOCK = 4096

Cast: TypeAlias = Callable[[Poses, NDArray[np.float64]], NDArray[np.float64]]
"""(N, 3) poses of the laser in the grid and (B,) directions to (N, B) ranges of the map [m]."""


def places(scan: Scan, grid_map: GridMap, count: int, seed: int) -> list[PoseTuple]:
    """The best places of one scan, best first.

    Args:
        scan: of one laser.
        grid_map: where the robot may be anywhere.
        count: number of poses returned.
        seed: of the positions.
    """
    rng, jumps = np.random.default_rng(seed), jump_field(grid_map.cells)
    measured = scan.ranges.array().astype(np.float64)
    ranges = np.minimum(np.nan_to_num(measured, posinf=scan.range_max_m), scan.range_max_m)
    angles = scan.angle_min_rad + scan.angle_step_rad * np.arange(len(ranges), dtype=np.float64)

    def cast(lasers: Poses, directions: NDArray[np.float64]) -> NDArray[np.float64]:
        in_map = compose(np.array(grid_map.map_from_grid), lasers)
        return cast_rays_from_poses(jumps, grid_map.grid, in_map, directions, scan.range_max_m)

    best = _best_anywhere(grid_map, cast, angles, ranges, count * _REFINED_PER_PLACE, rng)
    best = _refined(best, cast, angles, ranges, rng)
    best = best[np.unique(merge_overlapping(best, 0.5, 0.35))][:count]
    robots = compose(compose(np.array(grid_map.map_from_grid), best),
                     inverse(np.array(scan.robot_from_laser)))  # fmt: skip
    return [(float(x), float(y), float(heading)) for x, y, heading in robots]


def _best_anywhere(
    grid_map: GridMap,
    cast: Cast,
    angles: NDArray[np.float64],
    ranges: NDArray[np.float64],
    count: int,
    rng: np.random.Generator,
) -> Poses:
    """(count, 3) of the laser in the grid, with the least errors of all that are tried."""
    free = np.argwhere(grid_map.cells == FREE)
    number = int(len(free) * grid_map.cell_m**2 * POSITIONS_PER_M2)
    chosen = free[rng.integers(len(free), size=number)][:, ::-1]
    lasers = np.zeros((number, 3))
    lasers[:, :2] = (chosen + rng.random((number, 2))) * grid_map.cell_m
    every = np.arange(_RAYS, dtype=np.float64) * (2.0 * np.pi / _RAYS)
    measured = np.interp(every, np.mod(angles, 2.0 * np.pi), ranges, period=2.0 * np.pi)
    seen = np.abs(np.angle(np.exp(1j * (every - angles.mean())))) <= np.ptp(angles) / 2.0
    errors = np.concatenate([
        _errors(cast(lasers[first : first + _BLOCK], every), measured, seen, HEADINGS)
        for first in range(0, number, _BLOCK)
    ])  # fmt: skip
    kept = np.argsort(errors, axis=None)[:count]
    best = lasers[kept // HEADINGS]
    best[:, 2] = (kept % HEADINGS) * (2.0 * np.pi / HEADINGS)
    return best


def _refined(
    best: Poses,
    cast: Cast,
    angles: NDArray[np.float64],
    ranges: NDArray[np.float64],
    rng: np.random.Generator,
) -> Poses:
    """The best of tries around each pose, ever nearer; the least error first."""
    beams, rows = slice(None, None, max(len(ranges) // 60, 1)), np.arange(len(best))
    least = np.full(len(best), np.inf)
    for refinement in range(_ROUNDS):
        reach = np.array([0.15, 0.15, np.pi / HEADINGS]) * 0.7**refinement
        spread = rng.uniform(-1.0, 1.0, (len(best), _TRIES, 3)) * reach
        spread[:, 0] = 0.0
        tried = best[:, None] + spread
        error = np.abs(cast(tried.reshape(-1, 3), angles[beams]) - ranges[beams]).sum(axis=1)
        error = error.reshape(len(best), _TRIES)
        at = error.argmin(axis=1)
        best, least = tried[rows, at], error[rows, at]
    return np.asarray(best[np.argsort(least)])


@kernel
def _errors(cast: np.ndarray, measured: np.ndarray, seen: np.ndarray, headings: int) -> np.ndarray:
    """(N, headings) sums of absolute errors of the rays that the laser sees."""
    rays = len(measured)
    errors = np.zeros((len(cast), headings))
    for i in range(len(cast)):
        for heading in range(headings):
            shift, total = heading * (rays // headings), 0.0
            for ray in range(rays):
                if seen[ray]:
                    total += abs(cast[i, (ray + shift) % rays] - measured[ray])
            errors[i, heading] = total
    return errors
