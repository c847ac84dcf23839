"""Where a robot fits, and how it gets from one place to another."""

from math import floor

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, Points, Pose, Poses
from particle_filter.kernel_arguments import to_cells
from particle_filter.poses import compose
from protocol.errors import ClusterMclError
from protocol.messages import PoseTuple

_NODE_SPACING_M = 0.2
_CLEARANCE_M = 0.3
"""Between a planned path and the nearest obstacle."""
_LEAST_EXTENT_M = 1.0
_NO_ROOM = f"the map has no free ground of {_LEAST_EXTENT_M} m for a robot of 0.4 m to wander on"
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns to half of a node's eight neighbours; the others are their way back."""


class NoRoomError(ClusterMclError):
    """A map has no place where the simulated robot fits."""


class FreeSpace:
    """The ground of a world on which a robot can drive: the largest connected part of it.

    Args:
        ground: the map of what is really there.

    Raises:
        NoRoomError: the robot fits nowhere.
    """

    def __init__(self, ground: GridMap) -> None:
        self._cell_m = ground.cell_m
        self._map_from_grid: Pose = np.array(ground.map_from_grid)
        self._to_cells = to_cells(self._map_from_grid, ground.cell_m)
        padded = np.pad(ground.cells == FREE, 1)  # what lies off the map is not free
        self._clearance: NDArray[np.float32] = (
            distance_transform_edt(padded).astype(np.float32)[1:-1, 1:-1] - 0.5
        ) * np.float32(ground.cell_m)
        self._stride = max(1, round(_NODE_SPACING_M / ground.cell_m))
        self._graph, self._nodes = self._connected_ground()

    def clearance_m(self, x: float, y: float) -> float:
        """Distance from a point of the map to the nearest obstacle, within half a cell [m]."""
        row, col = self._cell_at(x, y)
        rows, cols = self._clearance.shape
        if not (0 <= row < rows and 0 <= col < cols):
            return 0.0
        return float(self._clearance[row, col])

    def random_pose(self, rng: np.random.Generator) -> PoseTuple:
        """A pose from where the robot can drive everywhere else."""
        x, y = self._points(rng.integers(len(self._nodes), size=1))[0]
        return float(x), float(y), float(rng.uniform(-np.pi, np.pi))

    def random_path(
        self, x: float, y: float, farthest_m: float, rng: np.random.Generator
    ) -> Points:
        """The way to a random goal, (n, 2) points some 0.2 m apart [m].

        Keeps to the middle where there is room: narrow ground counts longer than it is. From a
        place too near to an obstacle the way starts at the nearest one that is not.
        """
        start = self._nearest_node(x, y)
        costs, before = dijkstra(
            self._graph, indices=[start], limit=farthest_m, return_predecessors=True
        )
        reached = np.flatnonzero(np.isfinite(costs[0]))
        node = int(rng.choice(reached))
        path = [node]
        while node != start:
            node = int(before[0, node])
            path.append(node)
        return self._smoothed(self._points(np.array(path[::-1])))

    def _connected_ground(self) -> tuple[csr_array, NDArray[np.int64]]:
        """Neighbouring nodes with the cost of the way between, and each node's row and column."""
        half = self._stride // 2
        clearance = self._clearance[half :: self._stride, half :: self._stride]
        fits = clearance >= _CLEARANCE_M
        if not fits.any():
            raise NoRoomError(_NO_ROOM)
        number = np.full(fits.shape, -1)
        number[fits] = np.arange(np.count_nonzero(fits))
        spacing_m = self._stride * self._cell_m
        begins, ends, costs = [], [], []
        for row_step, col_step in _STEPS:
            here, there = _shifted(fits, row_step, col_step)
            both = fits[here] & fits[there]
            room = np.minimum(clearance[here][both], clearance[there][both])
            begins.append(number[here][both])
            ends.append(number[there][both])
            costs.append(np.hypot(row_step, col_step) * spacing_m * (1.0 + 0.3 / room))
        pairs = np.concatenate(begins), np.concatenate(ends)
        count = int(number.max()) + 1
        half_graph = coo_array((np.concatenate(costs), pairs), shape=(count, count))
        graph = csr_array(half_graph + half_graph.T)
        _, part = connected_components(graph, directed=False)
        largest = np.flatnonzero(part == np.bincount(part).argmax())
        nodes = np.argwhere(fits)[largest] * self._stride + half
        if np.ptp(nodes, axis=0).max() * self._cell_m < _LEAST_EXTENT_M:
            raise NoRoomError(_NO_ROOM)
        return csr_array(graph[largest][:, largest]), nodes

    def _points(self, nodes: NDArray[np.int64]) -> Points:
        """(n, 2) nodes in the map [m]."""
        in_grid = (self._nodes[nodes][:, ::-1] + 0.5) * self._cell_m
        poses: Poses = np.column_stack([in_grid, np.zeros(len(in_grid))])
        return compose(self._map_from_grid, poses)[:, :2]

    def _nearest_node(self, x: float, y: float) -> int:
        offsets = self._nodes - np.array(self._cell_at(x, y))
        return int(np.argmin((offsets**2).sum(axis=1)))

    def _smoothed(self, path: Points) -> Points:
        """The mean of five neighbours each, unless that is too near to an obstacle."""
        padded = np.pad(path, ((2, 2), (0, 0)), mode="edge")
        means = np.stack([padded[i : i + len(path)] for i in range(5)]).mean(axis=0)
        clear = [self.clearance_m(x, y) >= _CLEARANCE_M for x, y in means]
        return np.where(np.array(clear)[:, None], means, path)

    def _cell_at(self, x: float, y: float) -> tuple[int, int]:
        """Row and column; they may lie off the map."""
        c, s, x0, y0 = self._to_cells
        return floor(s * x + c * y + y0), floor(c * x - s * y + x0)


def _shifted(
    fits: NDArray[np.bool_], row_step: int, col_step: int
) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Windows of the same size on all nodes that have such a neighbour, and on the neighbours."""
    rows, cols = fits.shape
    here = slice(0, rows - row_step), slice(max(0, -col_step), cols - max(0, col_step))
    there = slice(row_step, rows), slice(max(0, col_step), cols - max(0, -col_step))
    return here, there
