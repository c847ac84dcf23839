"""The ground cut into places a step apart, and the ways between those where a robot fits."""

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from protocol.errors import ClusterMclError

CLEARANCE_M, CLEARANCE_BETWEEN_M = 0.3, 0.25
"""From a place, or from the way to the next, to any obstacle; the robot has a radius of 0.2 m."""
_SPACING_M = 0.2
_LEAST_EXTENT_M = 1.0
_STEPS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Rows and columns to half of a place's eight neighbours; the others are their way back."""
_DETOUR_M = 0.3
"""A way this near to an obstacle counts twice."""

Windows = tuple[tuple[slice, slice], tuple[slice, slice]]


class NoRoomError(ClusterMclError):
    """A map has no place where the simulated robot fits."""

    def __init__(self, extent_m: float) -> None:
        self.extent_m = extent_m
        problem = f"the map has no free ground {extent_m} m long that is wide enough"
        super().__init__(f"{problem} for the simulated robot, which needs 0.6 m")


def connected_ways(
    clearance: NDArray[np.float32], cell_m: float
) -> tuple[csr_array, NDArray[np.int64]]:
    """The largest connected part of the ground.

    Args:
        clearance: (rows, cols) distance from each cell to the nearest obstacle [m].
        cell_m: side of a cell [m].

    Returns:
        Sparse (n, n) costs of the ways between neighbours, which are their lengths [m] and more
        near obstacles; and (n, 2) row and column of each place.

    Raises:
        NoRoomError: that part is smaller than a robot needs to wander.
    """
    stride = max(1, round(_SPACING_M / cell_m))
    places = clearance[stride // 2 :: stride, stride // 2 :: stride]
    fits = places >= CLEARANCE_M
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
    """Costs of the ways between all places that fit, numbered row by row."""
    half, count = stride // 2, int(np.count_nonzero(fits))
    number = np.full(fits.shape, -1)
    number[fits] = np.arange(count)
    begins, ends, costs = [], [], []
    for step in _STEPS:
        here, there = _windows(fits.shape, step)
        rows, cols = np.nonzero(fits[here] & fits[there])
        rows, cols = rows + here[0].start, cols + here[1].start
        middle = half + rows * stride + step[0] * half, half + cols * stride + step[1] * half
        clear = clearance[middle] >= CLEARANCE_BETWEEN_M
        rows, cols, room = rows[clear], cols[clear], clearance[middle][clear]
        begins.append(number[rows, cols])
        ends.append(number[rows + step[0], cols + step[1]])
        costs.append(np.hypot(*step) * stride * cell_m * (1.0 + _DETOUR_M / room))
    pairs = np.concatenate(begins), np.concatenate(ends)
    one_way = coo_array((np.concatenate(costs), pairs), shape=(count, count))
    return csr_array(one_way + one_way.T)


def _windows(shape: tuple[int, ...], step: tuple[int, int]) -> Windows:
    """Windows of one size: on all places that have a neighbour at `step`, and on those."""
    rows, cols = shape
    here = slice(0, rows - step[0]), slice(max(0, -step[1]), cols - max(0, step[1]))
    there = slice(step[0], rows), slice(max(0, step[1]), cols - max(0, -step[1]))
    return here, there
