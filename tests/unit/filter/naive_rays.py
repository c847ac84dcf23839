"""The obvious way to cast rays: slow, plain, and easy to check by eye."""

from math import cos, sin

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import OCCUPIED, Cells, Pose
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.ray_casting import cast_rays_from_poses


def jump_field(cells: Cells) -> NDArray[np.uint8]:
    """Try larger and larger squares from every cell in every quadrant."""
    field = np.zeros((4, *cells.shape), np.uint8)
    for quadrant, row, col in np.ndindex(field.shape):
        for side in range(1, 256):
            low_row = row if quadrant & 2 else row - side + 1
            low_col = col if quadrant & 1 else col - side + 1
            square = cells[max(low_row, 0) : low_row + side, max(low_col, 0) : low_col + side]
            if square.shape != (side, side) or (square == OCCUPIED).any():
                break
            field[quadrant, row, col] = side
    return field


def cast_ray(cells: Cells, cell_m: float, pose: Pose, angle: float, max_range_m: float) -> float:
    """Cut the ray with every occupied cell, each a square, and keep the nearest cut."""
    rows, cols = np.nonzero(cells == OCCUPIED)
    heading = pose[2] + angle
    x_in, x_out = _between(pose[0], cos(heading), cols * cell_m, (cols + 1) * cell_m)
    y_in, y_out = _between(pose[1], sin(heading), rows * cell_m, (rows + 1) * cell_m)
    enters = np.maximum(np.maximum(x_in, y_in), 0.0)
    cut = enters[enters <= np.minimum(x_out, y_out)]
    return float(min([*cut, max_range_m]))


def cast_rays(
    cells: Cells,
    cell_m: float,
    grid_from_laser: Pose,
    angles: NDArray[np.float64],
    max_range_m: float,
) -> NDArray[np.float64]:
    """The product's rays from one pose, cell by cell: no jump is longer than one."""
    one_by_one = np.broadcast_to((cells != OCCUPIED).view(np.uint8), (4, *cells.shape))
    poses = np.reshape(grid_from_laser, (1, 3))
    grid = Grid(cells, cell_m, np.zeros(3))
    return cast_rays_from_poses(one_by_one, grid, poses, angles, max_range_m).reshape(-1)


def _between(
    start: float, along: float, low: NDArray[np.floating], high: NDArray[np.floating]
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """From when to when a moving coordinate lies between two bounds; it must move."""
    ends = (low - start) / along, (high - start) / along
    return np.minimum(*ends), np.maximum(*ends)
