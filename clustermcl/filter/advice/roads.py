"""Ground where the robot can drive, whichever of its possible places is right."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from clustermcl.filter.arrays import FREE, Pose, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.poses import compose

REACH_M = 20.0
"""Ways stay within this distance of the robot along x and y [m]."""
LEAST_REACH_M = 1.0
"""Ground that reaches less far from the robot counts as none [m]."""
MARGIN_M = 0.1
"""Least distance that a way keeps from obstacles, beyond the robot's radius [m]."""
SURE_SIGMAS = 1.0
"""The same, in standard deviations of the position that the way has at a place."""
_LATTICE_M = 0.1
"""Distance between points whose clearance is checked; nodes of ways are twice as far apart [m]."""
_NEAR_M = 0.5
"""Distance from the robot within which a place may have less clearance than required [m]."""
_NEARER_M = 0.02
"""There, a way may come nearer to obstacles than the robot is now by this [m]."""
_DETOUR = 0.2
"""Cost of driving near obstacles: clearance at which a metre costs twice [m]."""
SPACING_M, _MAX_SPOTS = 1.0, 200
"""Least distance between view points, and their largest number."""


@dataclass(frozen=True, eq=False)
class Roads:
    """Shortest ways from the robot to all reached nodes, and the spots from which it may look."""

    nodes: NDArray[np.float64]
    """(N, 2) x, y in the robot's frame [m]."""
    before: NDArray[np.int64]
    """(N,) the node before each on its way; negative: the robot's, or not reached."""
    origin: int
    spot_of: NDArray[np.int64]
    """(N,) the spot whose view stands for that of a node; -1: not reached."""
    spots: NDArray[np.int64]
    """(S,) node of each spot."""
    sure: NDArray[np.bool_]
    """(n, n) for points of the lattice: clear of obstacles whatever the errors of the places."""

    def way_to(self, node: int) -> NDArray[np.int64]:
        """Return the (n,) nodes of the way, from the robot's node on."""
        way = [node]
        while way[-1] != self.origin:
            way.append(int(self.before[way[-1]]))
        return np.array(way[::-1])

    def count_sure(self, way: NDArray[np.int64]) -> int:
        """Return how many nodes of a way can be driven to without a new question."""
        rows, cols = np.divmod(way, (len(self.sure) + 1) // 2)
        halfway = self.sure[rows[1:] + rows[:-1], cols[1:] + cols[:-1]]
        return 1 + int(np.argmin(np.append(halfway & self.sure[2 * rows[1:], 2 * cols[1:]], False)))


def roads_of(places: Poses, covariances: NDArray[np.float64], radius_m: float, grid: Grid) -> Roads:
    """Find the shortest ways on ground that is free at all (K, 3) places.

    `covariances` are the (K, 3, 3) of the places, `radius_m` is that of the robot.
    """
    middle = 2 * round(REACH_M / (2.0 * _LATTICE_M))
    axis = np.arange(-middle, middle + 1) * _LATTICE_M
    x, y = np.meshgrid(axis, axis)
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    near, clear = np.hypot(x, y) < _NEAR_M, np.full(x.shape, np.inf)
    drivable, sure = np.ones((2, *x.shape), np.bool_)
    for place, covariance in zip(places, covariances, strict=True):
        room, as_now = _clearance(grid, place, points), np.zeros_like(near)
        if room[middle, middle] < radius_m + MARGIN_M + _LATTICE_M:
            as_now[near] = _as_far_as_now(grid, place, points[near], radius_m)
        spread = SURE_SIGMAS * _spread(place, covariance, points)
        drivable &= (room > radius_m + max(spread[middle, middle], MARGIN_M)) | as_now
        sure &= (room > radius_m + np.maximum(spread, MARGIN_M)) | as_now
        clear = np.minimum(clear, room - spread)
    drivable[middle, middle] = True
    return _shortest(drivable, sure, clear, points)


def _from_robot(place: Pose, points: Poses) -> NDArray[np.float64]:
    """Return (2, n, n) x, y of points relative to the robot, along the axes of the map [m]."""
    x, y, c, s = points[..., 0], points[..., 1], math.cos(place[2]), math.sin(place[2])
    return np.stack([c * x - s * y, s * x + c * y])


def _spread(place: Pose, covariance: NDArray[np.float64], points: Poses) -> NDArray[np.float64]:
    """Return the largest standard deviation (n, n) of the position that points have in the map [m].

    The (n, n, 3) points are in the robot's frame; its pose has the (3, 3) covariance. An error of
    the heading displaces a point in proportion to its distance.
    """
    x, y = _from_robot(place, points)
    (xx, xy, xh), (_, yy, yh), (_, _, hh) = covariance
    along_x = xx - 2.0 * y * xh + y**2 * hh
    along_y = yy + 2.0 * x * yh + x**2 * hh
    both = xy + x * xh - y * yh - x * y * hh
    largest = 0.5 * (along_x + along_y) + np.hypot(0.5 * (along_x - along_y), both)
    return np.asarray(np.sqrt(np.maximum(largest, 0.0)))


def _clearance(grid: Grid, place: Pose, points: Poses) -> NDArray[np.float64]:
    """Return the distance (n, n) from points to ground that is not known to be free [m].

    The (n, n, 3) points are in the robot's frame. Only their surroundings in the map are read.
    """
    c, s, x0, y0 = grid.in_cells
    x, y = _from_robot(place, points) + place[:2, None, None]
    cols = np.floor(c * x - s * y + x0).astype(np.int64)
    rows = np.floor(s * x + c * y + y0).astype(np.int64)
    stride = max(round(_LATTICE_M / grid.cell_m), 1)
    first_row, first_col = int(rows.min()), int(cols.min())
    high, wide = int(np.ptp(rows)) // stride + 1, int(np.ptp(cols)) // stride + 1
    blocked = _blocked(grid, first_row, first_col, (high * stride, wide * stride))
    shifts = np.ndindex(stride, stride)
    blocks = np.logical_or.reduce([blocked[i::stride, j::stride] for i, j in shifts])
    # Half a block is subtracted, because the obstacle may begin at the block's border.
    room_m = (distance_transform_edt(np.logical_not(blocks)) - 0.5) * (stride * grid.cell_m)
    return np.asarray(room_m[(rows - first_row) // stride, (cols - first_col) // stride])


def _blocked(grid: Grid, row: int, col: int, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which cells of a part of the map are not known to be free, as all off the map."""
    blocked = np.ones(shape, np.bool_)
    low, left = max(row, 0), max(col, 0)
    part = grid.cells[low : max(row + shape[0], 0), left : max(col + shape[1], 0)]
    inside = blocked[low - row :, left - col :][: part.shape[0], : part.shape[1]]
    inside[:] = part != FREE
    return blocked


def _as_far_as_now(grid: Grid, place: Pose, points: Poses, radius_m: float) -> NDArray[np.bool_]:
    """Return which (n, 3) points are as far from obstacles as the robot now, by exact distances.

    None is, where the robot is nearer than half its radius: it cannot stand there, so the place or
    the map is wrong, and no way from it is known to be free.
    """
    c, s, x0, y0 = grid.in_cells
    here_and_points = compose(place, np.concatenate([np.zeros((1, 3)), points]))
    cols = c * here_and_points[:, 0] - s * here_and_points[:, 1] + x0
    rows = s * here_and_points[:, 0] + c * here_and_points[:, 1] + y0
    reach = math.ceil((_NEAR_M + radius_m) / grid.cell_m) + 1
    row, col = math.floor(rows[0]) - reach, math.floor(cols[0]) - reach
    blocked = _blocked(grid, row, col, (2 * reach + 1, 2 * reach + 1))
    # The nearest cell is one of the rim: all others would need gigabytes for a large robot.
    rim = np.argwhere(blocked & ~binary_erosion(blocked, border_value=1)) + np.array([row, col])
    rim = rim + 0.5
    if not len(rim):
        return np.full(len(points), not blocked[reach, reach])
    here = np.column_stack([rows, cols])
    _, near = cKDTree(rim).query(here, min(8, len(rim)))
    off = np.abs(here[:, None] - rim[near.reshape(len(here), -1)]) - 0.5
    room_m = np.hypot(*np.maximum(off, 0.0).T).min(axis=0) * grid.cell_m
    own = (np.floor(here) - (row, col)).astype(np.int64)
    room_m[blocked[own[:, 0], own[:, 1]]] = 0.0
    stands = room_m[0] > 0.5 * radius_m
    return np.asarray((room_m[1:] > room_m[0] - _NEARER_M) & stands)


def _shortest(
    drivable: NDArray[np.bool_], sure: NDArray[np.bool_], clear: NDArray[np.float64], points: Poses
) -> Roads:
    """Connect every second point of the lattice, if the points between them are free, too."""
    nodes = points[::2, ::2, :2].reshape(-1, 2)
    size = (len(drivable) + 1) // 2
    number = np.arange(size * size).reshape(size, size)
    begins, ends, costs = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        rows, cols = np.mgrid[0 : size - down, max(-right, 0) : size - max(right, 0)]
        at, to = (2 * rows, 2 * cols), (2 * (rows + down), 2 * (cols + right))
        half = (2 * rows + down, 2 * cols + right)
        open_ = drivable[at] & drivable[half] & drivable[to]
        room = np.maximum(clear[half][open_], 0.05)
        begins.append(number[rows, cols][open_])
        ends.append(number[rows + down, cols + right][open_])
        costs.append(2.0 * _LATTICE_M * math.hypot(down, right) * (1.0 + _DETOUR / room))
    count, origin = size * size, size * size // 2
    edges = (np.concatenate(costs), (np.concatenate(begins), np.concatenate(ends)))
    graph = coo_array(edges, shape=(count, count)).tocsr()
    graph = csr_array(graph + graph.T)
    lengths, befores = dijkstra(graph, indices=[origin], return_predecessors=True)
    reached = np.flatnonzero(np.isfinite(lengths[0]))
    spots, spot_of = _spots(nodes, reached, clear[::2, ::2].reshape(-1), origin)
    return Roads(nodes, np.asarray(befores[0], np.int64), origin, spot_of, spots, sure)


def _spots(
    nodes: NDArray[np.float64], reached: NDArray[np.int64], clear: NDArray[np.float64], origin: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Choose the roomiest node of each square as a spot, in about `_MAX_SPOTS` squares."""
    area = len(reached) * (2.0 * _LATTICE_M) ** 2
    side = max(SPACING_M, math.sqrt(area / _MAX_SPOTS))
    squares = np.round(nodes[reached] / side).astype(np.int64)
    _, square = np.unique(squares, axis=0, return_inverse=True)
    order = np.lexsort((-clear[reached], square.ravel()))
    _, first = np.unique(square.ravel()[order], return_index=True)
    spots = reached[order[first]]
    spots[square.ravel()[np.searchsorted(reached, origin)]] = origin
    spot_of = np.full(len(nodes), -1)
    spot_of[reached] = square.ravel()
    return spots, spot_of
