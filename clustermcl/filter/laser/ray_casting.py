"""Ray casting in a grid map: exact cell traversal that jumps over free squares.

The grid's frame: the low corner of cell [0, 0] is the origin, x = column * cell_m, y = row *
cell_m. Rays start anywhere, also outside the grid. Only occupied cells stop them, neither unknown
cells nor the area around the grid.
"""

from math import cos, floor, sin
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import OCCUPIED, Cells, Points, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import kernel, plain, read_only
from clustermcl.filter.poses import between

JumpField: TypeAlias = NDArray[np.uint8]
"""(4, rows, cols) number of cells that a ray may jump ahead from a cell: see `jump_field`."""

_LONGEST_JUMP = 255


def jump_field(cells: Cells) -> JumpField:
    """Compute the free square ahead of every cell, for rays of each quadrant.

    The square has the cell at one corner, extends within the map in the direction of the
    quadrant's rays, and has no occupied cell, so a ray can jump to its border. Squares around the
    cells would need a third more jumps.

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


def cast_rays_from_poses(
    jumps: JumpField,
    grid: Grid,
    map_from_laser: Poses,
    angles: NDArray[np.float64],
    max_range_m: float,
) -> NDArray[np.float64]:
    """Return the distance to the first occupied cell's boundary, for every pose and beam.

    Returns:
        (N, B) distances [m] for (N, 3) poses of the laser and (B,) directions in its frame [rad]; 0
        inside an occupied cell, `max_range_m` where nothing is hit.

    Raises:
        ValueError: a pose or an angle is not finite, or a length is not positive.

    References:
        Amanatides and Woo, A Fast Voxel Traversal Algorithm (1987).
    """
    if not (grid.cell_m > 0 and max_range_m > 0):
        raise ValueError(f"cell {grid.cell_m} m and range {max_range_m} m must be positive")
    if not (np.isfinite(map_from_laser).all() and np.isfinite(angles).all()):
        raise ValueError("rays start at finite poses and angles")
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    grid_from_laser = plain(between(grid.map_from_grid, map_from_laser))
    return _cast_all(read_only(jumps), grid.cell_m, grid_from_laser, directions, max_range_m)


@kernel
def _squares(cells: Cells) -> NDArray[np.uint8]:
    """Return the side of the largest free square that has each cell as its high corner."""
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
    ranges, ahead = np.empty((len(poses), len(directions))), flat(jumps)
    max_cells = max_range_m / cell_m
    for i in range(len(poses)):
        x, y = poses[i, 0] / cell_m, poses[i, 1] / cell_m
        c, s = cos(poses[i, 2]), sin(poses[i, 2])
        for j in range(len(directions)):
            dx = c * directions[j, 0] - s * directions[j, 1]
            dy = s * directions[j, 0] + c * directions[j, 1]
            cells = cast_ray(ahead, x, y, dx, dy, max_cells)
            ranges[i, j] = min(cells * cell_m, max_range_m)
    return ranges


@kernel
def span_in_grid(
    x: float, y: float, dx: float, dy: float, cols: float, rows: float
) -> tuple[float, float]:
    """Return the lengths at which a ray enters and leaves the grid; if it misses the grid, the
    first is larger."""
    t_in, t_out = 0.0, np.inf
    for start, along, length in ((x, dx, cols), (y, dy, rows)):
        if along != 0.0:
            low, high = -start / along, (length - start) / along
            t_in = max(t_in, min(low, high))
            t_out = min(t_out, max(low, high))
        elif start < 0.0 or start >= length:
            return np.inf, 0.0
    return t_in, t_out


FlatJumps: TypeAlias = tuple[NDArray[np.uint8], np.int32, np.int32]
"""A jump field in one dimension, and its numbers of rows and columns: see `flat`."""


@kernel
def flat(jumps: JumpField) -> FlatJumps:
    """Flatten a jump field for `cast_ray`, which then takes a third less time."""
    return jumps.reshape(-1), np.int32(jumps.shape[1]), np.int32(jumps.shape[2])


@kernel
def cast_ray(jumps: FlatJumps, x: float, y: float, dx: float, dy: float, until: float) -> float:
    """Follow a ray to the first occupied cell; called by kernels, with all lengths in cells.

    It starts at column x and row y from the grid's low corner, in the direction (dx, dy).

    Returns:
        The length to the boundary of the first occupied cell, in units of (dx, dy) as `until`;
        infinite if nothing is hit.
    """
    squares, height, width = jumps
    length = 0.0
    if not (0.0 <= x < width and 0.0 <= y < height):
        length, leaves = span_in_grid(x, y, dx, dy, float(width), float(height))
        until = min(leaves, until)
        if length > until:
            return np.inf
    # Clamp before int(), which truncates towards zero: -0.3 is not in column 0.
    col = np.int32(min(max(floor(x + length * dx), 0.0), width - 1.0))
    row = np.int32(min(max(floor(y + length * dy), 0.0), height - 1.0))
    right, up = dx >= 0.0, dy >= 0.0
    plane = np.int32(((2 if up else 0) + (1 if right else 0)) * height * width)
    per_x, per_y = 1.0 / dx if dx != 0.0 else np.inf, 1.0 / dy if dy != 0.0 else np.inf
    rim_x, rim_y = (0 if right else 1) - x, (0 if up else 1) - y
    step_x, step_y = np.int32(1 if right else -1), np.int32(1 if up else -1)
    while True:
        side = np.int32(squares[np.uintp(plane + row * width + col)])
        if side == 0:
            return length
        next_col, next_row = col + step_x * side, row + step_y * side
        t_x, t_y = (next_col + rim_x) * per_x, (next_row + rim_y) * per_y
        # The ray crosses one border of the square; along it, rounding must not leave the square.
        most = np.int32(side - 1)
        if t_x < t_y:
            length, on_row = t_x, np.int32(y + t_x * dy)
            row = np.int32(min(max(on_row, row - most), row + most))
            col = np.int32(next_col)
        else:
            length, on_col = t_y, np.int32(x + t_y * dx)
            col = np.int32(min(max(on_col, col - most), col + most))
            row = np.int32(next_row)
        if np.uintp(col) >= np.uintp(width) or np.uintp(row) >= np.uintp(height) or length > until:
            return np.inf
