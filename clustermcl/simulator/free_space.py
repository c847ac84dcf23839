"""The free space of a world: clearance, a grid roadmap, and random collision-free paths."""

from math import ceil, floor, hypot

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from clustermcl.filter.arrays import FREE, Points, Poses
from clustermcl.filter.poses import compose
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.protocol.floors import Floors
from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.maps.grid_map import GridMap

CLEARANCE_M, EDGE_CLEARANCE_M = 0.3, 0.25
"""Minimum distance from a node, and from an edge, to any obstacle [m]."""
_SPACING_M = 0.2
_NEIGHBOURS = np.array([(0, 1), (1, -1), (1, 0), (1, 1)])
"""Steps in row and column to half of a node's neighbours; the others are reached from there."""
_LEAST_EXTENT_M = 1.0
_DETOUR_M = 0.3
"""Clearance at which an edge costs twice its length [m]."""


class NoRoomError(ClusterMclError):
    """The free space of a map is too small for the simulated robot."""

    def __init__(self, extent_m: float) -> None:
        self.extent_m = extent_m
        super().__init__(
            f"the simulated robot needs free space {2 * CLEARANCE_M} m wide and {extent_m} m long; "
            "the map has none"
        )


def _roadmap(
    clearance: NDArray[np.float32], cell_m: float, floors: Floors
) -> tuple[csr_array, NDArray[np.int64]]:
    """Return the largest connected part of the roadmap, or that of each floor.

    Of (rows, cols) clearances [m]: sparse (n, n) edge costs, which are lengths [m], increased near
    obstacles; and the (n, 2) row and column of each node.
    """
    stride = max(1, round(_SPACING_M / cell_m))
    fits = clearance[stride // 2 :: stride, stride // 2 :: stride] >= CLEARANCE_M
    if not fits.any():
        raise NoRoomError(_LEAST_EXTENT_M)
    nodes = np.argwhere(fits) * stride + stride // 2
    costs = _costs(clearance, nodes, stride, cell_m)
    _, part = connected_components(costs, directed=False)
    whole = ((0.0, 0.0), (np.inf, np.inf))
    boxes = [(floor.low, floor.high) for floor in floors.floors] or [whole]
    kept = np.zeros(len(nodes), bool)
    for low, high in boxes:
        at = nodes[:, ::-1] * cell_m
        inside = np.all((at >= low) & (at < high), axis=1)
        kept |= inside & (part == np.bincount(part[inside], minlength=1).argmax())
    largest = np.flatnonzero(kept)
    if np.ptp(nodes[largest], axis=0).max() * cell_m < _LEAST_EXTENT_M:
        raise NoRoomError(_LEAST_EXTENT_M)
    return csr_array(costs[largest][:, largest]), nodes[largest]


def _costs(
    clearance: NDArray[np.float32], nodes: NDArray[np.int64], stride: int, cell_m: float
) -> csr_array:
    """Return sparse edge costs between neighbours among nodes, of which (n, 2) are row, column."""
    on_lattice = nodes // stride
    numbers = np.full(on_lattice.max(axis=0) + 2, -1)  # with a margin, which -1 also reaches
    numbers[tuple(on_lattice.T)] = np.arange(len(nodes))
    ends_by_step = numbers[tuple((on_lattice + _NEIGHBOURS[:, None]).transpose(2, 0, 1))]
    step, begins = np.nonzero(ends_by_step >= 0)
    ends, steps = ends_by_step[step, begins], _NEIGHBOURS[step]
    rows, cols = (nodes[begins] + steps * (stride // 2)).T
    clear = clearance[rows, cols] >= EDGE_CLEARANCE_M
    room = clearance[rows, cols][clear]
    costs = np.hypot(*steps[clear].T) * stride * cell_m * (1.0 + _DETOUR_M / room)
    count = len(nodes)
    one_way = coo_array((costs, (begins[clear], ends[clear])), shape=(count, count))
    return csr_array(one_way + one_way.T)


class FreeSpace:
    """The largest connected part of the free space, on each floor, in which a robot can drive.

    Raises:
        NoRoomError: the robot fits nowhere.
    """

    def __init__(self, ground: GridMap) -> None:
        self._grid = ground.grid
        # Cells off the map count as blocked.
        blocked = np.pad(ground.cells != FREE, 1, constant_values=True)
        self._clearance: NDArray[np.float32] = (
            distance_transform_edt(~blocked)[1:-1, 1:-1].astype(np.float32) - np.float32(0.5)
        ) * np.float32(ground.cell_m)
        self._graph, self._nodes = _roadmap(self._clearance, ground.cell_m, ground.floors)

    def clearance_m(self, x: float, y: float) -> float:
        """Return the distance from a point to the nearest obstacle, within half a cell [m].

        Unknown space is an obstacle; the distance of a point off the map is 0.
        """
        row, col = self._cell_at(x, y)
        rows, cols = self._clearance.shape
        if not (0 <= row < rows and 0 <= col < cols):
            return 0.0
        return float(self._clearance[row, col])

    def has_room_between(self, x: float, y: float, to_x: float, to_y: float) -> bool:
        """Return whether the line between two points is `EDGE_CLEARANCE_M` from obstacles."""
        steps = max(1, ceil(hypot(to_x - x, to_y - y) / self._grid.cell_m))
        return all(
            self.clearance_m(x + (to_x - x) * i / steps, y + (to_y - y) * i / steps)
            >= EDGE_CLEARANCE_M
            for i in range(1, steps + 1)
        )

    def roomiest_near(self, x: float, y: float) -> tuple[float, float]:
        """Return the point with the largest clearance on a circle of 0.15 m around a point."""
        bearings = np.arange(16) * np.pi / 8
        around = [(x + 0.15 * float(np.cos(b)), y + 0.15 * float(np.sin(b))) for b in bearings]
        return max(around, key=lambda place: self.clearance_m(*place))

    def where_it_fits(self, pose: PoseTuple, radius_m: float) -> PoseTuple:
        """Return the pose if a robot of this radius fits there.

        Otherwise return the position of the nearest roadmap node, with the same heading.
        """
        if self.clearance_m(pose[0], pose[1]) >= radius_m:
            return pose
        x, y = self._points(np.array([self._nearest_node(pose[0], pose[1])]))[0]
        return float(x), float(y), pose[2]

    def random_pose(self, rng: np.random.Generator) -> PoseTuple:
        x, y = self._points(rng.integers(len(self._nodes), size=1))[0]
        return float(x), float(y), float(rng.uniform(-np.pi, np.pi))

    def random_path(
        self, x: float, y: float, farthest_m: float, rng: np.random.Generator
    ) -> Points:
        """Return a path to a random goal, (n, 2) points about 0.2 m apart [m].

        The path starts at the roadmap node nearest to x, y. Edge costs make it prefer wide
        passages, and sum to at most `farthest_m`.
        """
        start = self._nearest_node(x, y)
        costs, before = dijkstra(
            self._graph, indices=[start], limit=farthest_m, return_predecessors=True
        )
        reached = np.flatnonzero(np.isfinite(costs[0]))
        node = int(rng.choice(reached))
        return self._path(start, node, before[0])

    def path_to(self, start: tuple[float, float], goal: tuple[float, float]) -> Points:
        """Return a path between two positions on one floor, as `random_path` does."""
        first, last = self._nearest_node(*start), self._nearest_node(*goal)
        _, before = dijkstra(self._graph, indices=[first], return_predecessors=True)
        return self._path(first, last, before[0])

    def _path(self, start: int, node: int, before: NDArray[np.int32]) -> Points:
        path = [node]
        while node != start and before[node] >= 0:
            node = int(before[node])
            path.append(node)
        return self._smoothed(self._points(np.array(path[::-1])))

    def _points(self, nodes: NDArray[np.int64]) -> Points:
        """Return (n, 2) node positions in the map [m]."""
        in_grid = (self._nodes[nodes][:, ::-1] + 0.5) * self._grid.cell_m
        poses: Poses = np.column_stack([in_grid, np.zeros(len(in_grid))])
        return np.asarray(compose(self._grid.map_from_grid, poses)[:, :2])

    def _nearest_node(self, x: float, y: float) -> int:
        offsets = self._nodes - np.array(self._cell_at(x, y))
        return int(np.argmin((offsets**2).sum(axis=1)))

    def _smoothed(self, path: Points) -> Points:
        """Return moving averages of five points; a point stays if its average would collide."""
        padded = np.pad(path, ((2, 2), (0, 0)), mode="edge")
        means = np.stack([padded[i : i + len(path)] for i in range(5)]).mean(axis=0)
        for i, (x, y) in enumerate(path):
            before, after = means[max(i - 1, 0)], path[min(i + 1, len(path) - 1)]
            to, on = (*before, *means[i]), (*means[i], *after)
            if not (self.has_room_between(*to) and self.has_room_between(*on)):
                means[i] = x, y
        return np.asarray(means)

    def _cell_at(self, x: float, y: float) -> tuple[int, int]:
        c, s, x0, y0 = self._grid.in_cells
        return floor(s * x + c * y + y0), floor(c * x - s * y + x0)
