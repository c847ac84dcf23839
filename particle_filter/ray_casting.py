"""How far a ray gets in a grid map: exact cell traversal that jumps over empty squares.

The grid's frame: the low corner of cell [0, 0] is the origin, x = column * cell_m, y = row *
cell_m. Rays start anywhere, also outside the grid. Only occupied cells stop them: unknown
cells and what lies around the grid let them pass.
"""

from math import cos, floor, sin
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import OCCUPIED, Cells, Points, Pose, Poses
from particle_filter.kernel_arguments import plain, read_only
from particle_filter.kernels import kernel

JumpField: TypeAlias = NDArray[np.uint8]
"""(rows, cols) chessboard distance to the nearest occupied cell [cells], at most 255."""


def jump_field(cells: Cells) -> JumpField:
    """Chessboard distance of every cell to the nearest occupied one, computed once per map.

    A ray in a cell of distance k meets nothing while it moves by less than k cells along
    either axis, so it jumps k - 1 cells at once and still hits exactly the right cell.

    Args:
        cells: (rows, cols) grid map.

    Returns:
        (rows, cols) 0 on occupied cells; 255 also stands for all that is farther.

    References:
        Rosenfeld and Pfaltz (1966): two passes are exact for the chessboard distance.
    """
    return _two_passes(read_only(cells))


def cast_rays(
    cells: Cells,
    cell_m: float,
    grid_from_laser: Pose,
    angles: NDArray[np.float64],
    max_range_m: float,
) -> NDArray[np.float64]:
    """Distance from a laser to the first occupied cell's boundary along each beam.

    Walks cell by cell, with nothing computed ahead; of many poses, see `cast_rays_from_poses`.

    Args:
        cells: (rows, cols) grid map.
        cell_m: side of a cell [m].
        grid_from_laser: (3,) pose of the laser in the grid's frame.
        angles: (B,) directions of the beams in the laser's frame [rad].
        max_range_m: how far a ray is followed [m].

    Returns:
        (B,) distances [m]; 0 inside an occupied cell, `max_range_m` where nothing is hit.

    Raises:
        ValueError: the pose or an angle is not finite, or a length is not positive.

    References:
        Amanatides and Woo, A Fast Voxel Traversal Algorithm (1987).
    """
    one_by_one = (cells != OCCUPIED).view(np.uint8)
    poses = np.reshape(grid_from_laser, (1, 3))
    return cast_rays_from_poses(one_by_one, cell_m, poses, angles, max_range_m).reshape(-1)


def cast_rays_from_poses(
    jumps: JumpField,
    cell_m: float,
    grid_from_laser: Poses,
    angles: NDArray[np.float64],
    max_range_m: float,
) -> NDArray[np.float64]:
    """Distance to the first occupied cell's boundary, for every pose and beam.

    Args:
        jumps: (rows, cols) `jump_field` of the map.
        cell_m: side of a cell [m].
        grid_from_laser: (N, 3) poses of the laser in the grid's frame.
        angles: (B,) directions of the beams in the laser's frame [rad].
        max_range_m: how far a ray is followed [m].

    Returns:
        (N, B) distances [m]; 0 inside an occupied cell, `max_range_m` where nothing is hit.

    Raises:
        ValueError: a pose or an angle is not finite, or a length is not positive.
    """
    if not (cell_m > 0 and max_range_m > 0):
        raise ValueError(f"cell {cell_m} m and range {max_range_m} m must be positive")
    if not (np.isfinite(grid_from_laser).all() and np.isfinite(angles).all()):
        raise ValueError("rays start at finite poses and angles")
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return _cast_all(read_only(jumps), cell_m, plain(grid_from_laser), directions, max_range_m)


@kernel
def _two_passes(cells: Cells) -> JumpField:
    rows, cols = cells.shape
    field = np.full((rows, cols), 255, dtype=np.uint8)
    for row in range(rows):
        for col in range(cols):
            if cells[row, col] == OCCUPIED:
                field[row, col] = 0
                continue
            nearest = 254
            if col > 0:
                nearest = min(nearest, field[row, col - 1])
            if row > 0:
                for near in range(max(col - 1, 0), min(col + 2, cols)):
                    nearest = min(nearest, field[row - 1, near])
            field[row, col] = nearest + 1
    for row in range(rows - 1, -1, -1):
        for col in range(cols - 1, -1, -1):
            nearest = int(field[row, col]) - 1  # a byte cannot hold -1
            if col < cols - 1:
                nearest = min(nearest, field[row, col + 1])
            if row < rows - 1:
                for near in range(max(col - 1, 0), min(col + 2, cols)):
                    nearest = min(nearest, field[row + 1, near])
            field[row, col] = max(nearest + 1, 0)
    return field


@kernel
def _cast_all(
    jumps: JumpField,
    cell_m: float,
    poses: Poses,
    directions: Points,
    max_range_m: float,
) -> NDArray[np.float64]:
    ranges = np.empty((len(poses), len(directions)))
    for i in range(len(poses)):
        x, y = poses[i, 0] / cell_m, poses[i, 1] / cell_m
        c, s = cos(poses[i, 2]), sin(poses[i, 2])
        for j in range(len(directions)):
            dx = c * directions[j, 0] - s * directions[j, 1]
            dy = s * directions[j, 0] + c * directions[j, 1]
            cells_far = cast_ray(jumps, x, y, dx, dy, max_range_m / cell_m)
            ranges[i, j] = min(cells_far * cell_m, max_range_m)
    return ranges


@kernel
def cast_ray(jumps: JumpField, x: float, y: float, dx: float, dy: float, max_cells: float) -> float:
    """Follow one ray; kernels call it, and everything is in cells.

    Args:
        jumps: (rows, cols) `jump_field` of the map.
        x: start, columns from the grid's low corner.
        y: start, rows from the grid's low corner.
        dx: unit direction along the columns.
        dy: unit direction along the rows.
        max_cells: how far the ray is followed.

    Returns:
        Cells to the boundary of the first occupied cell; infinite where nothing is hit.
    """
    rows, cols = jumps.shape
    t, t_exit = _span_in_grid(x, y, dx, dy, float(cols), float(rows))
    t_last = min(t_exit, max_cells)
    if t > t_last:
        return np.inf
    # Clamp before int(), which truncates towards zero: -0.3 is no place in column 0.
    col = int(min(max(floor(x + t * dx), 0.0), cols - 1.0))
    row = int(min(max(floor(y + t * dy), 0.0), rows - 1.0))
    step_x, step_y = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
    side_x, side_y = (1.0 if dx > 0.0 else 0.0), (1.0 if dy > 0.0 else 0.0)
    per_x = 1.0 / dx if dx != 0.0 else np.inf
    per_y = 1.0 / dy if dy != 0.0 else np.inf
    per_jump = 1.0 / max(abs(dx), abs(dy))
    while True:
        clear = jumps[row, col]
        if clear == 0:
            return t
        if clear > 1:
            t += (clear - 1) * per_jump
            if t > t_last:
                return np.inf
            # Inside the grid but for rounding, so int() cannot be a whole cell off.
            col = min(int(x + t * dx), cols - 1)
            row = min(int(y + t * dy), rows - 1)
            continue
        t_x = (col + side_x - x) * per_x if dx != 0.0 else np.inf
        t_y = (row + side_y - y) * per_y if dy != 0.0 else np.inf
        if t_x < t_y:
            t = t_x
            col += step_x
        else:
            t = t_y
            row += step_y
        if t > t_last or col < 0 or row < 0 or col >= cols or row >= rows:
            return np.inf


@kernel
def _span_in_grid(
    x: float, y: float, dx: float, dy: float, cols: float, rows: float
) -> tuple[float, float]:
    """Where a ray enters and leaves the grid; it enters after it leaves when it misses."""
    t_in, t_out = 0.0, np.inf
    for start, along, length in ((x, dx, cols), (y, dy, rows)):
        if along != 0.0:
            low, high = -start / along, (length - start) / along
            t_in = max(t_in, min(low, high))
            t_out = min(t_out, max(low, high))
        elif start < 0.0 or start >= length:
            return np.inf, 0.0
    return t_in, t_out
