"""What particles pay for standing where no robot can: walls do not pass for free."""

import numpy as np

from particle_filter.arrays import FREE, Cells, LogWeights, Poses
from particle_filter.kernel_arguments import ToCells, plain
from particle_filter.kernels import kernel
from particle_filter.sensor_model import Grid


def ground_log_penalty(map_from_robot: Poses, grid: Grid, log_penalty: float) -> LogWeights:
    """What each particle pays for the ground it stands on.

    Args:
        map_from_robot: (N, 3) poses.
        grid: the map.
        log_penalty: for ground that is occupied, unknown or off the map.

    Returns:
        (N,) `log_penalty` or 0.
    """
    return _penalties(plain(map_from_robot), grid.cells, grid.in_cells, log_penalty)


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
