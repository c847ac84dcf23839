"""One ray through a grid map, for who asks ray after ray whether something is in its way.

`ray_casting.cast_fan` follows many rays at a time, which is faster where all of them are followed
to their ends; here no more rays are followed than it takes to know.
"""

from math import floor
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from particle_filter.kernels import kernel
from particle_filter.ray_casting import JumpField, span_in_grid

FlatJumps: TypeAlias = tuple[NDArray[np.uint8], np.int32, np.int32]
"""A jump field in one dimension, its rows, its columns: see `flat`."""


@kernel
def flat(jumps: JumpField) -> FlatJumps:
    """A jump field as `cast_ray` takes it: in three dimensions it would take half as long again."""
    return jumps.reshape(-1), np.int32(jumps.shape[1]), np.int32(jumps.shape[2])


@kernel
def cast_ray(jumps: FlatJumps, x: float, y: float, dx: float, dy: float, until: float) -> float:
    """Follow a ray to the first occupied cell; kernels call it, and everything is in cells.

    Args:
        jumps: `flat` of the map's jump field.
        x: start, columns from the grid's low corner.
        y: start, rows from the grid's low corner.
        dx: direction along the columns.
        dy: direction along the rows.
        until: how far it is followed, in lengths of its direction.

    Returns:
        The same length to the boundary of the first occupied cell, to the last bit, that
        `cast_fan` gives; infinite where nothing is hit.
    """
    squares, height, width = jumps
    length = 0.0
    if not (0.0 <= x < width and 0.0 <= y < height):
        length, leaves = span_in_grid(x, y, dx, dy, float(width), float(height))
        until = min(leaves, until)
        if length > until:
            return np.inf
    # Clamp before int(), which truncates towards zero: -0.3 is no place in column 0.
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
        # Across the border that it leaves by; along it, within the square whatever rounding says.
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
