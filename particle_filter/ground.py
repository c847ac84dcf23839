"""What particles pay for standing where no robot can: walls do not pass for free."""

import numpy as np

from particle_filter.arrays import FREE, Cells, LogWeights, Pose, Poses
from particle_filter.kernel_arguments import ToCells, plain, read_only, to_cells
from particle_filter.kernels import kernel


def ground_log_penalty(
    map_from_robot: Poses, cells: Cells, cell_m: float, map_from_grid: Pose, log_penalty: float
) -> LogWeights:
    """What each particle pays for the ground it stands on.

    Args:
        map_from_robot: (N, 3) poses.
        cells: (rows, cols) grid; row 0 has the lowest y.
        cell_m: side of a cell [m].
        map_from_grid: (3,) the outer corner of cell (0, 0), in the map's frame.
        log_penalty: for ground that is occupied, unknown or off the map.

    Returns:
        (N,) `log_penalty` or 0.
    """
    in_cells = to_cells(map_from_grid, cell_m)
    return _penalties(plain(map_from_robot), read_only(cells), in_cells, float(log_penalty))


@kernel
def _penalties(poses: Poses, cells: Cells, in_cells: ToCells, log_penalty: float) -> LogWeights:
    c, s, x0, y0 = in_cells
    rows, cols = cells.shape
    penalties = np.full(len(poses), log_penalty)
    for i in range(len(poses)):
        # Compared before int(), which rounds towards zero: just below the map is not in cell 0.
        col = c * poses[i, 0] - s * poses[i, 1] + x0
        row = s * poses[i, 0] + c * poses[i, 1] + y0
        if 0.0 <= col < cols and 0.0 <= row < rows and cells[int(row), int(col)] == FREE:
            penalties[i] = 0.0
    return penalties
