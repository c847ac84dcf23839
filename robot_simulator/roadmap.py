"""A grid roadmap: nodes where the robot fits, edges along which it can drive."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from protocol.errors import ClusterMclError

CLEARANCE_M, EDGE_CLEARANCE_M = 0.3, 0.25
"""Distance of a node and of an edge to any obstacle [m]; the robot's radius is 0.2 m."""
_SPACING_M = 0.2
_LEAST_EXTENT_M = 1.0
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Row and column offsets of four of the eight neighbours; edges are symmetric."""
_DETOUR_M = 0.3
"""An edge at this clearance costs twice its length."""

Windows = tuple[tuple[slice, slice], tuple[slice, slice]]


class NoRoomError(ClusterMclError):
    """A map has no place where the simulated robot fits."""

    def __init__(self, extent_m: float) -> None:
        self.extent_m = extent_m
        problem = f"the map has no free ground {extent_m} m long that is wide enough"
        super().__init__(f"{problem} for the simulated robot, which needs 0.6 m")


def connected_roadmap(
    clearance: NDArray[np.float32], cell_m: float
) -> tuple[csr_array, NDArray[np.int64]]:
    """Build the roadmap and keep its largest connected component.

    Args:
        clearance: (rows, cols) distance from each cell to the nearest obstacle [m].
        cell_m: side of a cell [m].

    Returns:
        Sparse (n, n) edge costs: length [m], increased near obstacles; and (n, 2) row and
        column of each node.

    Raises:
        NoRoomError: the component is less than 1 m long.
    """
    stride = max(1, round(_SPACING_M / cell_m))
    nodes = clearance[stride // 2 :: stride, stride // 2 :: stride]
    fits = nodes >= CLEARANCE_M
    if not fits.any():
        raise NoRoomError(_LEAST_EXTENT_M)
    costs = _costs(clearance, fits, stride, cell_m)
    _, part = connected_components(costs, directed=False)
    largest = np.flatnonzero(part == np.bincount(part).argmax())
    rows_cols = np.argwhere(fits)[largest] * stride + stride // 2
    if np.ptp(rows_cols, axis=0).max() * cell_m < _LEAST_EXTENT_M:
        raise NoRoomError(_LEAST_EXTENT_M)
    return csr_array(costs[largest][:, largest]), rows_cols


def _costs(
    clearance: NDArray[np.float32], fits: NDArray[np.bool_], stride: int, cell_m: float
) -> csr_array:
    """Edge costs between all nodes where the robot fits, numbered row by row."""
    half, count = stride // 2, int(np.count_nonzero(fits))
    number = np.full(fits.shape, -1)
    number[fits] = np.arange(count)
    begins, ends, costs = [], [], []
    for step in _STEPS:
        here, there = _windows(fits.shape, step)
        rows, cols = np.nonzero(fits[here] & fits[there])
        rows, cols = rows + here[0].start, cols + here[1].start
        middle = half + rows * stride + step[0] * half, half + cols * stride + step[1] * half
        clear = clearance[middle] >= EDGE_CLEARANCE_M
        rows, cols, room = rows[clear], cols[clear], clearance[middle][clear]
        begins.append(number[rows, cols])
        ends.append(number[rows + step[0], cols + step[1]])
        costs.append(np.hypot(*step) * stride * cell_m * (1.0 + _DETOUR_M / room))
    pairs = np.concatenate(begins), np.concatenate(ends)
    one_way = coo_array((np.concatenate(costs), pairs), shape=(count, count))
    return csr_array(one_way + one_way.T)


def _windows(shape: tuple[int, ...], step: tuple[int, int]) -> Windows:
    """Two windows of one size: nodes that have a neighbour at `step`, and these neighbours."""
    rows, cols = shape
    here = slice(0, rows - step[0]), slice(max(0, -step[1]), cols - max(0, step[1]))
    there = slice(step[0], rows), slice(max(0, step[1]), cols - max(0, -step[1]))
    return here, there
