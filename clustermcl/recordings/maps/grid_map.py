"""The occupancy grid map: free, occupied and unknown cells, and the grid's pose."""

from __future__ import annotations  # `help` shows names of types, not their definitions

import hashlib
import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.poses import compose
from clustermcl.protocol.floors import ONE_MAP, Floors
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark

MAX_CELLS = 2**28
"""Limit for the cells of a map: 16,384 x 16,384. Larger files and messages are refused before
memory is allocated."""

FREE_PERCENT, OCCUPIED_PERCENT = 25, 65
"""Largest occupancy of a free cell, and least of an occupied one [%]."""
LARGE_CELLS = 2**23
"""Number of cells above which a map is cropped; smaller maps keep their digests."""
RIM_M = 5.0
"""Margin around the known cells, wider than the range of a likelihood field [m]."""
_DIGEST_VERSION = b"clustermcl map 1\n"


@dataclass(frozen=True, eq=False, repr=False)
class GridMap:
    """An immutable occupancy grid.

    Args:
        cells: (rows, cols) int8: 0 free, 1 occupied, -1 unknown; row 0 has the lowest y.
        cell_m: side of a cell [m].
        map_from_grid: pose of the low corner of cell [0, 0] in the map frame (ROS: `origin`).
        landmarks: landmarks of the map.
        remarks: what was assumed or is odd in its source, as sentences.
        floors: the floors of a building, of which this map is the atlas.

    Raises:
        ValueError: the array is not such a grid or has no free cell, or the geometry is not finite.
    """

    cells: Cells
    cell_m: float
    map_from_grid: PoseTuple
    landmarks: tuple[Landmark, ...] = ()
    remarks: tuple[str, ...] = ()
    floors: Floors = ONE_MAP

    def __post_init__(self) -> None:
        cells = self.cells
        if cells.dtype != np.int8 or cells.ndim != 2 or cells.size == 0:
            raise ValueError(f"cells must be a 2-d int8 array, not {cells.dtype} {cells.shape}")
        if cells.min() < UNKNOWN or cells.max() > OCCUPIED:
            raise ValueError(f"cells must be -1, 0 or 1, not {cells.min()} to {cells.max()}")
        if cells.all():  # all but `FREE`; a comparison would take as much memory again
            raise ValueError("no cell is free, so no pose is possible")
        if not (math.isfinite(self.cell_m) and self.cell_m > 0.0):
            raise ValueError(f"cell_m must be a positive length, not {self.cell_m}")
        if len(self.map_from_grid) != 3 or not all(map(math.isfinite, self.map_from_grid)):
            raise ValueError(f"map_from_grid must be three finite numbers: {self.map_from_grid}")
        if cells.flags.writeable or not cells.flags.c_contiguous:
            cells = cells.copy()
            cells.flags.writeable = False
            object.__setattr__(self, "cells", cells)

    @classmethod
    def from_array(
        cls, occupancy: ArrayLike, cell_m: float, origin: ArrayLike = (0.0, 0.0, 0.0)
    ) -> GridMap:
        """Return the map of an array.

        Args:
            occupancy: (rows, cols) probabilities that a cell is occupied: of bool, or of numbers
                up to 1, or, if any is above 1, in percent as in `nav_msgs/OccupancyGrid`. Up to
                25 % is free, from 65 to 100 % occupied, any other, as -1, unknown. So cells of 1
                are walls where all are 0 or 1. Row 0 has the lowest y: flip an image with
                `numpy.flipud`.
            cell_m: side of a cell [m].
            origin: (3,) pose of the low corner of cell [0, 0] in the map: x [m], y [m],
                heading [rad].

        Raises:
            ValueError: the array is not (rows, cols), no cell is free, or the geometry is not
                finite.
        """
        values = np.asarray(occupancy)
        if not (values > 1).any():
            values = values * np.float32(100)
        x, y, heading = np.asarray(origin, np.float64).tolist()
        return cls(cells_of(values), cell_m, (x, y, heading))

    def __repr__(self) -> str:
        (rows, cols), (width_m, height_m) = self.cells.shape, self.size_m
        size = f"{width_m:.1f} m x {height_m:.1f} m, {cols} x {rows} cells"
        floors = f", {len(self.floors.names)} floors" if self.floors else ""
        return f"<GridMap of {size}, {len(self.landmarks)} landmarks{floors}>"

    def with_landmarks(self, landmarks: Iterable[Landmark]) -> GridMap:
        """Return the map with these landmarks in place of its own."""
        return replace(self, landmarks=tuple(landmarks))

    def with_remarks(self, *remarks: str) -> GridMap:
        """Return the map with further remarks; empty ones are left out."""
        return replace(self, remarks=(*self.remarks, *filter(None, remarks)))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of geometry, cells, landmarks and floors, in hex; in maps with the same digest, a
        pose is the same place."""
        if not self.landmarks and not self.floors:
            return self.cells_digest
        marks = [(mark.name, mark.x + 0.0, mark.y + 0.0, mark.sigma) for mark in self.landmarks]
        summed = hashlib.sha256(self.cells_digest.encode())
        summed.update(msgspec.msgpack.encode(marks))
        if self.floors:
            summed.update(msgspec.msgpack.encode(self.floors))
        return summed.hexdigest()

    @cached_property
    def cells_digest(self) -> str:
        """Digest of the map without its landmarks and the names of floors."""
        rows, cols = self.cells.shape
        geometry = (self.cell_m, *(value + 0.0 for value in self.map_from_grid))  # no -0.0
        summed = hashlib.sha256(_DIGEST_VERSION + struct.pack("<QQdddd", rows, cols, *geometry))
        summed.update(self.cells.data)
        return summed.hexdigest()

    @cached_property
    def grid(self) -> Grid:
        """The map for the particle filter."""
        return Grid(self.cells, self.cell_m, np.array(self.map_from_grid))

    @property
    def size_m(self) -> tuple[float, float]:
        """Width along the columns and height along the rows [m]."""
        rows, cols = self.cells.shape
        return cols * self.cell_m, rows * self.cell_m


def cells_of(occupancy: NDArray[Any]) -> Cells:
    """Convert ROS occupancy in percent to cells, by the thresholds of nav2's map_saver.

    Most maps have 0, 100 and -1 only; of maps with probabilities, AMCL would use hardly a cell.
    """
    cells = np.full(occupancy.shape, UNKNOWN, np.int8)
    cells[(occupancy >= 0) & (occupancy <= FREE_PERCENT)] = FREE
    cells[(occupancy >= OCCUPIED_PERCENT) & (occupancy <= 100)] = OCCUPIED
    return cells


def coarse(cells: Cells, every: int) -> Cells:
    """Return a grid whose cells replace squares of `every` cells a side.

    A coarse cell is occupied if any of its cells is; otherwise it is free if any is free.
    """
    for axis in range(2):
        cells = np.maximum.reduceat(cells, np.arange(0, cells.shape[axis], every), axis=axis)
    return cells


def known_part(cells: Cells, cell_m: float, map_from_grid: PoseTuple) -> GridMap:
    """Return a map of the given cells; a large map is cropped to its known part and a margin.

    A pose stays at the same place. A site plan with one building costs as much as a map of the
    building.
    """
    if cells.ndim != 2 or cells.size <= LARGE_CELLS:
        return GridMap(cells, cell_m, map_from_grid)
    rows, cols = (np.flatnonzero(cells.max(axis=axis) > UNKNOWN) for axis in (1, 0))
    if not len(rows) or not cell_m > 0.0:
        return GridMap(cells, cell_m, map_from_grid)  # raises the error
    rim = ceil(min(RIM_M / cell_m, cells.size))
    row, col = max(int(rows[0]) - rim, 0), max(int(cols[0]) - rim, 0)
    part = cells[row : int(rows[-1]) + 1 + rim, col : int(cols[-1]) + 1 + rim]
    x, y, _ = compose(np.array(map_from_grid), np.array([col * cell_m, row * cell_m, 0.0]))
    return GridMap(part, cell_m, (float(x), float(y), map_from_grid[2]))
