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
"""(4, rows, cols) how far a ray may jump ahead from anywhere in a cell: see `jump_field`."""

_LONGEST_JUMP = 255


def jump_field(cells: Cells) -> JumpField:
    """The free square ahead of every cell, for rays of each quadrant; computed once per map.

    The cell is the square's corner, and the square lies in the direction in which the rays of the
    quadrant run, within the map. It holds no occupied cell, so a ray leaves it before it meets
    anything, and what it enters then is exactly the right cell. A square that looks ahead only is
    larger than one around the cell, which a wall beside or behind the ray makes small: there are
    a third fewer jumps.

    Args:
        cells: (rows, cols) grid map.

    Returns:
        (4, rows, cols) sides of the squares [cells], at most 255, 0 on occupied cells; quadrant
        2 * up + right, where right is dx >= 0 and up is dy >= 0.
    """
    fields = np.empty((4, *cells.shape), np.uint8)
    for quadrant in range(4):
        rows = slice(None, None, -1 if quadrant & 2 else 1)
        cols = slice(None, None, -1 if quadrant & 1 else 1)
        fields[quadrant] = _squares(read_only(cells[rows, cols]))[rows, cols]
    return fields


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
    one_by_one = np.broadcast_to((cells != OCCUPIED).view(np.uint8), (4, *cells.shape))
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
        jumps: `jump_field` of the map.
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
def _squares(cells: Cells) -> NDArray[np.uint8]:
    """Sides of the largest free squares of the map that end in each cell."""
    rows, cols = cells.shape
    field = np.empty((rows, cols), np.uint8)
    for row in range(rows):
        for col in range(cols):
            if cells[row, col] == OCCUPIED:
                field[row, col] = 0
            elif row == 0 or col == 0:
                field[row, col] = 1
            else:
                least = min(field[row - 1, col], field[row, col - 1], field[row - 1, col - 1])
                field[row, col] = min(int(least), _LONGEST_JUMP - 1) + 1
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
        jumps: `jump_field` of the map.
        x: start, columns from the grid's low corner.
        y: start, rows from the grid's low corner.
        dx: direction along the columns; lengths count in lengths of the direction.
        dy: direction along the rows.
        max_cells: how far the ray is followed.

    Returns:
        Length to the boundary of the first occupied cell; infinite where nothing is hit.
    """
    rows, cols = jumps.shape[1], jumps.shape[2]
    t, t_last = 0.0, max_cells
    if not (0.0 <= x < cols and 0.0 <= y < rows):
        t, t_last = _span_in_grid(x, y, dx, dy, float(cols), float(rows))
        t_last = min(t_last, max_cells)
        if t > t_last:
            return np.inf
    # Clamp before int(), which truncates towards zero: -0.3 is no place in column 0.
    col = int(min(max(floor(x + t * dx), 0.0), cols - 1.0))
    row = int(min(max(floor(y + t * dy), 0.0), rows - 1.0))
    right, up = dx >= 0.0, dy >= 0.0
    ahead = jumps[(2 if up else 0) + (1 if right else 0)]
    per_x = 1.0 / dx if dx != 0.0 else np.inf
    per_y = 1.0 / dy if dy != 0.0 else np.inf
    while True:
        side = int(ahead[row, col])
        if side == 0:
            return t
        t_x = ((col + side if right else col - side + 1) - x) * per_x
        t_y = ((row + side if up else row - side + 1) - y) * per_y
        # Into the next cell across the border that it leaves by; along that border it stays
        # within the square, whatever rounding says.
        if t_x < t_y:
            t = t_x
            col = col + side if right else col - side
            if t > t_last or not 0 <= col < cols:
                return np.inf
            row = min(max(int(y + t * dy), row - side + 1), row + side - 1)
        else:
            t = t_y
            row = row + side if up else row - side
            if t > t_last or not 0 <= row < rows:
                return np.inf
            col = min(max(int(x + t * dx), col - side + 1), col + side - 1)


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
