"""The occupancy grid of a map, with its pose."""

from dataclasses import dataclass
from functools import cached_property

from particle_filter.arrays import Cells, Pose
from particle_filter.kernels import ToCells, read_only, to_cells


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
