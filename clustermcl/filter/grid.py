"""The occupancy grid of a map, with its pose."""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from clustermcl.filter.arrays import FREE, Cells, Pose
from clustermcl.filter.kernels.compiled import ToCells, read_only, to_cells

T = TypeVar("T")
MOST_KEPT = 4
"""Results of slow functions that are kept for a map."""


@dataclass(frozen=True, eq=False)
class Grid:
    """The cells of a map, and the pose of the grid."""

    cells: Cells
    """(rows, cols); row 0 has the lowest y."""
    cell_m: float
    """Side of a cell [m]."""
    map_from_grid: Pose
    """(3,) pose of the outer corner of cell (0, 0) in the map's frame."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "cells", read_only(self.cells))

    @cached_property
    def in_cells(self) -> ToCells:
        """The transform from points of the map to cells of the grid."""
        return to_cells(self.map_from_grid, self.cell_m)

    @cached_property
    def free_m2(self) -> float:
        """Area of the free cells [m²]."""
        return int(np.count_nonzero(self.cells == FREE)) * self.cell_m**2

    @cached_property
    def _kept(self) -> dict[Hashable, Any]:
        return {}

    def once(self, key: Hashable, compute: Callable[[], T]) -> T:
        """Return the result of a slow function of this map by a key; the last `MOST_KEPT` are kept.

        They end with the map: a process may serve many robots, each with a map of its own. The
        result must not refer to this grid.
        """
        result = self._kept.pop(key, None)
        self._kept[key] = result = compute() if result is None else result
        while len(self._kept) > MOST_KEPT:
            self._kept.pop(next(iter(self._kept)), None)
        return result
