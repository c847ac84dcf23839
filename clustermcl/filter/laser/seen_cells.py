"""Which cells of a map a scan contradicts: beams that pass through walls, or end on free ground.

Cells are coarse, some 0.1 m, so that the errors of poses and maps fall into one cell or the next.
"""

from math import ceil, cos, floor, sin, sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, OCCUPIED, Cells, Pose
from clustermcl.filter.kernels.compiled import ToCells, kernel

Codes: TypeAlias = NDArray[np.uint16]
"""(rows, cols) bits of each cell: `WALL`, `OPEN`, `WATCHED`, and marks of the kernel."""

WALL, GROUND, OPEN, WATCHED = 1, 2, 4, 8
"""The map has an obstacle; is free; is free here and around. Every sight is reported."""
_NEAR, _HIT, _PASSED, _MOST, _UNMARKED = 16, 1 << 5, 1 << 10, 31, 15
"""Marks of one scan: beams end in a cell or next to it; units of the numbers of beams that end in
it and that pass it, up to 31 each; and the bits of a code without marks."""
NOT_WATCHED = np.uint16(~WATCHED & 0xFFFF)
WALL_MARGIN = 2
"""Cells around an obstacle of the map that beams may hit without contradicting it."""
BEYOND_M = 0.3
"""A beam passed an obstacle of the map if it ends this far behind it [m]."""
_BEFORE = 1.5
"""A beam passed free ground up to this distance before its end [cells]."""


def codes_of(cells: Cells) -> Codes:
    """Return the codes of a map's coarse cells."""
    wall, free = cells == OCCUPIED, cells == FREE
    is_open = free & ~widened(wall, WALL_MARGIN)
    return np.asarray(WALL * wall + GROUND * free + OPEN * is_open, np.uint16)


def widened(mask: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    """Return the cells that are at most `by` rows and columns away from one of a mask."""
    wide, (rows, cols) = np.pad(mask, by), mask.shape
    shifts = np.ndindex(2 * by + 1, 2 * by + 1)
    return np.asarray(np.any([wide[i : i + rows, j : j + cols] for i, j in shifts], axis=0))


@kernel
def seen_cells(  # noqa: PLR0912 - loops over beams and cells
    codes: Codes,
    seen: NDArray[np.int32],
    now: int,
    in_cells: ToCells,
    laser: Pose,
    ranges: NDArray[np.float64],
    first_angle: float,
    angle_step: float,
    no_return: float,
    reach: float,
    beyond: float,
    out: NDArray[np.int32],
) -> int:
    """Write the cells that a scan contradicts or that are watched to `out`; return their number.

    A cell is occupied if at least as many beams end in it as pass it, and free if beams pass it and
    none ends in it or next to it. A few beams that end at people do not hide that it is free.

    Args:
        codes: see `codes_of`; the marks are removed again.
        seen: (rows, cols) when a beam last passed or hit each cell; set to `now`.
        now: the present time, as in `seen`.
        in_cells: transform from points of the map to cells.
        laser: (3,) the laser in the map.
        ranges: (B,) lengths of the beams [m]; not positive, `no_return` or more: no return.
        first_angle: direction of the first beam on the laser [rad].
        angle_step: from one beam to the next [rad].
        no_return: see `ranges` [m].
        reach: length of beams that is used [cells].
        beyond: `BEYOND_M` [cells].
        out: (N, 2) cell, as row * cols + col, and whether it is occupied; no more than N cells that
            the scan has passed or hit are looked at.
    """
    c, s, x0, y0 = in_cells
    rows, cols = codes.shape
    from_col = c * laser[0] - s * laser[1] + x0
    from_row = s * laser[0] + c * laser[1] + y0
    count = 0
    for turn in range(2):  # count ends, then passes
        for j in range(len(ranges)):
            if not 0.0 < ranges[j] < no_return:
                continue
            angle = laser[2] + first_angle + j * angle_step
            x, y = ranges[j] * cos(angle), ranges[j] * sin(angle)
            dx, dy = c * x - s * y, s * x + c * y
            length = sqrt(dx * dx + dy * dy)
            steps = 9 if turn == 0 else ceil(min(length - _BEFORE, reach)) - 1
            if not length > 0.0 or (turn == 0 and length > reach):
                continue
            for k in range(steps):  # the cell of the end and those around, or those on the way
                along = 1.0 if turn == 0 else (k + 1) / length
                col, row = floor(from_col + along * dx), floor(from_row + along * dy)
                if turn == 0:
                    col, row = col + k % 3 - 1, row + k // 3 - 1
                if not (0 <= col < cols and 0 <= row < rows):
                    continue
                code = codes[row, col]
                if turn == 0:
                    is_end = k == 4 and (code // _HIT) & _MOST < _MOST
                    marked = (code | _NEAR) + (_HIT if is_end else 0)
                elif code // _PASSED == _MOST or (code & WALL and k + 1 > length - beyond):
                    continue
                else:
                    marked = code + _PASSED
                if code <= _UNMARKED:
                    if count == len(out):
                        continue
                    out[count, 0] = row * cols + col
                    count += 1
                codes[row, col] = marked
    news = 0
    for i in range(count):
        row, col = out[i, 0] // cols, out[i, 0] % cols
        code = codes[row, col]
        ends, passes, is_near = (code // _HIT) & _MOST, code // _PASSED, code & _NEAR
        codes[row, col] = code & _UNMARKED
        if ends or passes:
            seen[row, col] = now
        is_free = passes and (not is_near or (not code & WALL and passes > max(2, 3 * ends)))
        is_occupied = not is_free and (ends >= passes if ends else is_near and code & WATCHED)
        if (is_free and code & (WALL | WATCHED)) or (is_occupied and code & (OPEN | WATCHED)):
            out[news, 0], out[news, 1] = out[i, 0], 1 if is_occupied else 0
            news += 1
    return news
