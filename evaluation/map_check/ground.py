"""Statistics of a map's ground: free, occupied and unknown shares, pieces, and open borders."""

import msgspec
import numpy as np
from scipy.ndimage import binary_dilation, label

from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN

SMALLEST_PIECE_M2 = 0.5
"""Smaller free components are ignored."""


class Ground(msgspec.Struct, frozen=True, kw_only=True):
    """Statistics of a map."""

    rows: int
    cols: int
    cell_m: float
    width_m: float
    height_m: float
    free_m2: float
    occupied_share: float
    unknown_share: float
    pieces: int
    """Number of connected components of free ground of at least 0.5 m², or 1."""
    largest_piece_share: float
    """Share of the free ground in the largest component."""
    open_rim_share: float
    """Share of unknown cells among the cells that border free ground."""


def ground_of(grid_map: GridMap) -> Ground:
    cells = grid_map.cells
    free = cells == FREE
    numbers, _ = label(free)
    sizes = np.bincount(numbers.ravel())[1:] * grid_map.cell_m**2
    # Ground off the map is unknown, too.
    padded = np.pad(cells, 1, constant_values=UNKNOWN)
    rim = padded[binary_dilation(padded == FREE) & (padded != FREE)]
    rows, cols = cells.shape
    width_m, height_m = grid_map.size_m
    return Ground(
        rows=rows,
        cols=cols,
        cell_m=grid_map.cell_m,
        width_m=width_m,
        height_m=height_m,
        free_m2=grid_map.free_area_m2,
        occupied_share=float(np.mean(cells == OCCUPIED)),
        unknown_share=float(np.mean(cells == UNKNOWN)),
        pieces=max(int(np.count_nonzero(sizes >= SMALLEST_PIECE_M2)), 1),
        largest_piece_share=float(sizes.max() / sizes.sum()),
        open_rim_share=float(np.mean(rim == UNKNOWN)) if len(rim) else 0.0,
    )
