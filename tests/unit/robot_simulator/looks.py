"""What can be seen of a world from where."""

import numpy as np
from numpy.typing import NDArray

from grid_maps.grid_map import GridMap
from particle_filter.poses import between
from particle_filter.ray_casting import cast_rays_from_poses, jump_field
from protocol.message import PoseTuple

ALL_AROUND = np.linspace(-np.pi, np.pi, 1440, endpoint=False)


def unlike_when_turned(grid_map: GridMap, times: int) -> NDArray[np.bool_]:
    """Cells that some turn by 1 / `times` of a full turn changes."""
    turns = range(4 // times, 4, 4 // times)
    turned = [np.rot90(grid_map.cells, quarters) for quarters in turns]
    return np.asarray(np.any([grid_map.cells != cells for cells in turned], axis=0))


def beams_that_touch(
    grid_map: GridMap, cells: NDArray[np.bool_], poses: list[PoseTuple], range_m: float
) -> NDArray[np.int64]:
    """(N,) how many of 1,440 rays all around each pose touch some of these cells."""
    in_grid = between(np.array(grid_map.map_from_grid), np.array(poses))
    lengths = [
        cast_rays_from_poses(
            jump_field(np.where(cells, value, grid_map.cells).astype(np.int8)),
            grid_map.cell_m, in_grid, ALL_AROUND, range_m,
        )
        for value in (0, 1)
    ]  # fmt: skip
    shorter = lengths[1] < lengths[0] - 1e-6  # by more than rounding
    return np.asarray(np.count_nonzero(shorter, axis=1))
