"""Reads maps in the text format of CMU's robotics courses (`wean.dat`).

A header of `robot_specifications->NAME VALUE` lines (lengths in centimetres), then
`global_map[0]: NX NY`, then one line of NY numbers for each x: **the first index is x, the second
y**. A number is -1 for unknown, else the probability that the cell is **free**. Some copies of the
course's text state the opposite.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap, known_part
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from protocol.errors import MapFileError

FREE_ABOVE = 0.8
"""Probability above which a cell is free; areas outside the walls have 0.5 up to this value."""
OCCUPIED_BELOW = 0.35
"""Probability of being free below which a cell is occupied."""

_RESOLUTION = "robot_specifications->resolution"
_GRID_START = "global_map[0]:"
_MAX_SIDE = 32_768


def is_wean_map(content: bytes) -> bool:
    """Return whether the first 4,096 bytes of a file have this format."""
    start = content[:4096]
    return b"robot_specifications->" in start or _GRID_START.encode() in start


def parse_wean_map(content: bytes, path: Path) -> GridMap:
    """Parse a map; the origin of its frame is the low corner of the grid.

    Raises:
        MapFileError: the text is not such a map, is truncated, or has no free space.
    """
    lines = content.decode("ascii", errors="replace").splitlines()
    cell_m, sides, first = _header(lines, path)
    free_probability = _grid(lines, first, sides, path)
    cells: Cells = np.full(free_probability.shape, UNKNOWN, np.int8)
    cells[free_probability > FREE_ABOVE] = FREE
    cells[(free_probability >= 0.0) & (free_probability < OCCUPIED_BELOW)] = OCCUPIED
    if not np.any(cells == FREE):
        raise MapFileError(path, f"no free space: no number above {FREE_ABOVE}")
    return known_part(np.ascontiguousarray(cells.T), cell_m, (0.0, 0.0, 0.0))


def _header(lines: list[str], path: Path) -> tuple[float, tuple[int, int], int]:
    """Return the cell size [m], the numbers of cells in x and y, and the index of the first line
    of numbers."""
    cell_m: float | None = None
    for index, line in enumerate(lines):
        words = line.split()
        if words[:1] == [_RESOLUTION]:
            cell_m = _cell_m(words, path, index + 1)
        elif words[:1] == [_GRID_START]:
            if cell_m is None:
                raise MapFileError(path, f"no {_RESOLUTION} before the grid", line=index + 1)
            return cell_m, _sides(words, path, index + 1), index + 1
    raise MapFileError(path, f"cut off: no line {_GRID_START!r}", line=len(lines))


def _cell_m(words: list[str], path: Path, line: int) -> float:
    try:
        cell_cm = float(words[1])
    except (IndexError, ValueError):
        raise MapFileError(path, "the resolution is not a number", line=line) from None
    if not 0.0 < cell_cm < 10_000.0:
        raise MapFileError(path, f"resolution {cell_cm} cm: must be positive", line=line)
    return cell_cm / 100.0


def _sides(words: list[str], path: Path, line: int) -> tuple[int, int]:
    try:
        x_cells, y_cells = (int(word) for word in words[1:])
    except ValueError:
        raise MapFileError(path, f"{_GRID_START} needs two whole numbers", line=line) from None
    if not (0 < x_cells <= _MAX_SIDE and 0 < y_cells <= _MAX_SIDE):
        problem = f"{x_cells} x {y_cells} cells: each side must be 1 to {_MAX_SIDE}"
        raise MapFileError(path, problem, line=line)
    return x_cells, y_cells


def _grid(lines: list[str], first: int, sides: tuple[int, int], path: Path) -> NDArray[np.float64]:
    """Return the file's (x_cells, y_cells) numbers."""
    x_cells, y_cells = sides
    if len(lines) < first + x_cells:
        problem = f"cut off: {len(lines) - first} of {x_cells} lines of numbers"
        raise MapFileError(path, problem, line=len(lines))
    grid = np.empty(sides)
    for x in range(x_cells):
        words = lines[first + x].split()
        number = first + x + 1
        if len(words) != y_cells:
            cut = "; the file may be cut off" if number == len(lines) else ""
            problem = f"{len(words)} numbers, expected {y_cells}{cut}"
            raise MapFileError(path, problem, line=number)
        try:
            grid[x] = words
        except ValueError as error:
            raise MapFileError(path, str(error), line=number) from None
        if not np.all((grid[x] == -1.0) | ((grid[x] >= 0.0) & (grid[x] <= 1.0))):
            problem = "a number is neither -1 (unknown) nor a probability"
            raise MapFileError(path, problem, line=number)
    return grid
