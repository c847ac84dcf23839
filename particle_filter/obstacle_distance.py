"""How far every cell of a grid is from the nearest obstacle, exactly."""

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from particle_filter.kernel_arguments import read_only
from particle_filter.kernels import kernel


def obstacle_distance(blocked: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Distance from the middle of each cell to that of the nearest blocked one [cells].

    The same numbers as scipy's `distance_transform_edt` in a tenth of its time, for in a building
    no wall is far: columns are swept first, then each row is searched to both sides for as long
    as something nearer may come.

    Args:
        blocked: (rows, cols) whether a cell is an obstacle.

    Returns:
        (rows, cols) distances, 0 on obstacles; infinite where there is no obstacle at all.
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
    """The least of the distances to the nearest of every column."""
    rows, cols = in_column.shape
    far = rows + cols
    nearest = np.empty((rows, cols), np.float32)
    for row in range(rows):
        for col in range(cols):
            least = np.int64(in_column[row, col]) ** 2
            across = 1
            while across * across < least and (across <= col or col + across < cols):
                for other in (col - across, col + across):
                    if 0 <= other < cols:
                        least = min(least, across * across + np.int64(in_column[row, other]) ** 2)
                across += 1
            nearest[row, col] = sqrt(least) if least < far * far else np.inf
    return nearest
