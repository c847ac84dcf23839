"""Maps that have aged: what a robot gets whose building has changed since it was mapped.

The robot's recording stays as it is, and its map is changed: pieces of the walls' surface are moved
aside, removed or added, passages are closed. New furniture stands in the scans, too.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.kernels.compiled import to_cells
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses, jump_field
from clustermcl.filter.poses import compose
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap

Mask = NDArray[np.bool_]
"""(rows, cols) cells of a map."""

_TRIES = 20_000
_DIRECTIONS = 12
"""Directions tried in which a piece may be moved to free ground."""
_FURNITURE_CLEARANCE_M = 0.5
"""Distance of new furniture from the robot's path [m]."""
_RANGE_NOISE_M = 0.02


@dataclass(frozen=True, kw_only=True)
class Pieces:
    """How pieces of the walls' surface differ between map and building."""

    share: float
    """Share of the surface that is taken."""
    side_m: tuple[float, float] = (0.6, 2.0)
    """Least and largest side of the square that a piece fills [m]."""
    aside_m: tuple[float, float] = (0.5, 3.0)
    """Least and largest distance by which a piece is moved [m]."""
    removed: bool = True
    """The map lacks the pieces at their places."""
    painted: bool = True
    """The map has the pieces aside."""


def with_pieces(grid_map: GridMap, change: Pieces, rng: np.random.Generator) -> GridMap:
    """Return a map whose surface has been changed by pieces."""
    cells, cell_m = grid_map.cells.copy(), grid_map.cell_m
    old = grid_map.cells
    left = surface(old)
    wanted = (1.0 - change.share) * np.count_nonzero(left)
    for _ in range(_TRIES):
        if np.count_nonzero(left) <= wanted:
            break
        row, col = rng.choice(np.argwhere(left))
        half = max(round(rng.uniform(*change.side_m) / 2.0 / cell_m), 1)
        box = np.s_[max(row - half, 0) : row + half + 1, max(col - half, 0) : col + half + 1]
        corner = np.array([box[0].start, box[1].start])
        piece = np.argwhere(old[box] == OCCUPIED) + corner
        left[box] = False
        if change.removed:
            cells[tuple(piece.T)] = FREE
        if change.painted:
            cells[tuple(_aside(piece, change, old, cell_m, rng).T)] = OCCUPIED
    return GridMap(cells, cell_m, grid_map.map_from_grid)


def surface(cells: Cells) -> Mask:
    """Return the occupied cells with a free one beside them."""
    return np.asarray((cells == OCCUPIED) & binary_dilation(cells == FREE))


def _aside(
    piece: NDArray[np.int64],
    change: Pieces,
    cells: Cells,
    cell_m: float,
    rng: np.random.Generator,
) -> NDArray[np.int64]:
    """Return the (N, 2) free cells on which a moved piece stands; as many as possible."""
    best = piece[:0]
    for _ in range(_DIRECTIONS):
        distance, angle = rng.uniform(*change.aside_m) / cell_m, rng.uniform(0.0, 2.0 * np.pi)
        by = np.rint(distance * np.array([np.sin(angle), np.cos(angle)])).astype(np.int64)
        moved = piece + by
        moved = moved[((moved >= 0) & (moved < cells.shape)).all(axis=1)]
        moved = moved[cells[tuple(moved.T)] == FREE]
        best = max(best, moved, key=len)
    return best


def with_closed_passages(
    grid_map: GridMap, width_m: tuple[float, float], count: int, rng: np.random.Generator
) -> GridMap:
    """Return a map in which passages of a width [m] are closed, as by doors or new walls."""
    cells, cell_m = grid_map.cells.copy(), grid_map.cell_m
    least, most = (round(width / cell_m) for width in width_m)
    runs = [
        (axis, line, first, last)
        for axis, turned in enumerate((cells, cells.T))
        for line, row in enumerate(turned)
        for first, last in _free_runs(row)
        if least <= last - first <= most
    ]
    for index in rng.permutation(len(runs))[:count]:
        axis, line, first, last = runs[index]
        (cells.T if axis else cells)[line : line + 2, first:last] = OCCUPIED
    return GridMap(cells, cell_m, grid_map.map_from_grid)


def _free_runs(row: NDArray[np.int8]) -> list[tuple[int, int]]:
    """Return the first and the last + 1 of each row of free cells between obstacles."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], row == FREE, [False]))))
    pairs = edges.reshape(-1, 2).tolist()
    return [
        (first, last)
        for first, last in pairs
        if first > 0 and last < len(row) and row[first - 1] == row[last] == OCCUPIED
    ]


def furniture(
    grid_map: GridMap, share: float, path: Sequence[PoseTuple], rng: np.random.Generator
) -> Mask:
    """Return the cells of furniture on a share of the free ground, not on the robot's path."""
    cells, cell_m = grid_map.cells, grid_map.cell_m
    free, placed = cells == FREE, np.zeros(cells.shape, bool)
    c, s, x0, y0 = to_cells(np.array(grid_map.map_from_grid), cell_m)
    clear = _FURNITURE_CLEARANCE_M / cell_m
    on_path = np.array([(s * x + c * y + y0, c * x - s * y + x0) for x, y, _ in path])
    wanted = share * np.count_nonzero(free)
    candidates = np.argwhere(free)
    for _ in range(_TRIES):
        if np.count_nonzero(placed) >= wanted:
            break
        low = candidates[rng.integers(len(candidates))]
        high = low + np.maximum(np.rint(rng.uniform(0.3, 1.6, 2) / cell_m), 1).astype(np.int64)
        near = (on_path > low - clear) & (on_path < high + clear)
        if not near.all(axis=1).any():
            placed[low[0] : high[0], low[1] : high[1]] = True
    return np.asarray(placed & free)


def with_furniture(grid_map: GridMap, placed: Mask) -> GridMap:
    """Return a map with furniture."""
    cells = np.where(placed, np.int8(OCCUPIED), grid_map.cells)
    return GridMap(cells, grid_map.cell_m, grid_map.map_from_grid)


def seen_with_furniture(
    steps: Sequence[tuple[Scan, PoseTuple]],
    grid_map: GridMap,
    placed: Mask,
    rng: np.random.Generator,
) -> list[tuple[Scan, PoseTuple]]:
    """Return steps whose beams end at furniture that stands before what they have seen."""
    cells = np.where(placed, np.int8(OCCUPIED), np.int8(UNKNOWN))
    jumps = jump_field(cells)
    changed = []
    for scan, truth in steps:
        ranges = scan.ranges.array().astype(np.float64)
        angles = scan.angle_min_rad + scan.angle_step_rad * np.arange(len(ranges))
        laser = compose(np.array(truth), np.array(scan.robot_from_laser))[None]
        seen = cast_rays_from_poses(jumps, grid_map.grid, laser, angles, scan.range_max_m)[0]
        seen += _RANGE_NOISE_M * rng.standard_normal(len(seen))
        returned = (ranges > 0.0) & (ranges < scan.range_max_m)
        is_nearer = (seen < scan.range_max_m) & ~(returned & (ranges <= seen))
        ranges = np.where(is_nearer, np.maximum(seen, 0.001), ranges)
        blob = ArrayBlob.of(ranges.astype(np.float32), "float32")
        changed.append((replace(scan, ranges=blob), truth))
    return changed
