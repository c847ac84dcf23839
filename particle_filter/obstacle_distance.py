"""How far every cell of a grid is from the nearest obstacle, exactly."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from particle_filter.kernel_arguments import read_only
from particle_filter.kernels import kernel


def obstacle_distance(blocked: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance from the middle of each cell to that of the nearest blocked one [cells].

    The same numbers as scipy's `distance_transform_edt` in a fraction of its time: columns are
    swept first, then rows, each cell a few times however far obstacles are.

    Args:
        blocked: (rows, cols) whether a cell is an obstacle.

    Returns:
        (rows, cols) distances, 0 on obstacles; infinite where there is no obstacle at all.

    References:
        Meijster, Roerdink and Hesselink, "A general algorithm for computing distance transforms in
        linear time" (2000).
    """
    return _nearest(_along_columns(read_only(blocked)))


@kernel
def _along_columns(blocked: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Distance to the nearest blocked cell of the same column; where there is none, very far."""
    rows, cols = blocked.shape
    far = np.int32(rows + cols)
    distance = np.empty((rows, cols), np.int32)
    for row in range(rows):
        for col in range(cols):
            above = distance[row - 1, col] if row > 0 else far
            distance[row, col] = 0 if blocked[row, col] else min(above + 1, far)
    for row in range(rows - 2, -1, -1):
        for col in range(cols):
            distance[row, col] = min(distance[row, col], distance[row + 1, col] + 1)
    return distance


@kernel
def _nearest(in_column: NDArray[np.int32]) -> NDArray[np.float32]:
    """The least of the distances to the nearest of every column.

    In a row, squared distances by way of each column are parabolas: first the columns are found
    whose parabola is the lowest somewhere, and from where on each is; then it is read off.
    """
    rows, cols = in_column.shape
    far = rows + cols
    nearest = np.empty((rows, cols), np.float32)
    lowest, begins = np.empty(cols, np.int64), np.empty(cols, np.int64)
    for row in range(rows):
        by_way_of = in_column[row]
        last, lowest[0], begins[0] = 0, 0, 0
        for col in range(1, cols):
            while last >= 0 and (
                _squared(by_way_of, lowest[last], begins[last])
                > _squared(by_way_of, col, begins[last])
            ):
                last -= 1
            begin = 0
            if last >= 0:
                other = lowest[last]
                more = _squared(by_way_of, col, 0) - _squared(by_way_of, other, 0)
                begin = 1 + more // (2 * (col - other))
            if begin < cols:
                last += 1
                lowest[last], begins[last] = col, begin
        for col in range(cols - 1, -1, -1):
            squared = _squared(by_way_of, lowest[last], col)
            nearest[row, col] = sqrt(squared) if squared < far * far else np.inf
            if col == begins[last]:
                last -= 1
    return nearest


@kernel
def _squared(by_way_of: NDArray[np.int32], way: int, col: int) -> int:
    """Squared distance from a column of a row to the nearest obstacle of another column."""
    return int((col - way) ** 2 + np.int64(by_way_of[way]) ** 2)
