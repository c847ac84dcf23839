"""Finds beams whose ends are occluded at a pose.

The likelihood field rewards a beam that ends near an obstacle, even if a wall is in front of it. So
a wrong place among many walls may score better than the true one. Ray casting shows the difference,
but takes a hundred times longer; it is done for a few particles of each cluster.
"""

from math import cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Points, Poses
from clustermcl.filter.kernels.compiled import ToCells, kernel
from clustermcl.filter.laser.ray_casting import FlatJumps, JumpField, cast_ray, flat

OCCLUSION_MARGIN_M = 0.45
"""A beam may end this far behind the first obstacle on its ray, as map and pose have errors [m]."""
OCCLUSION_SLACK_RAD = 0.05
"""An end is occluded only if rays turned by this to either side are cut off too [rad]: if the pose
is slightly wrong, a ray along a wall may enter it for metres, but then one neighbour does not."""
_SLACK, _BACK = OCCLUSION_SLACK_RAD, -2.0 * OCCLUSION_SLACK_RAD
_TURNS = (1.0, 0.0), (cos(_SLACK), sin(_SLACK)), (cos(_BACK), sin(_BACK))
"""Cosine and sine of the turns to a ray itself, and then to one on either side."""


@kernel
def occluded_scores(
    poses: Poses,
    laser: NDArray[np.float64],
    hits: Points,
    codes: NDArray[np.uint16],
    jumps: JumpField,
    in_cells: ToCells,
    margin: float,
    log_step: float,
    stride: int,
) -> NDArray[np.float64]:
    """Return (N,) scores of occluded beams; `margin` is in cells."""
    c, s, x0, y0 = in_cells
    rows, cols = jumps.shape[1], jumps.shape[2]
    sums, ahead = np.zeros(len(poses)), flat(jumps)
    for i in range(len(poses)):
        ch, sh = cos(poses[i, 2]), sin(poses[i, 2])
        laser_x = poses[i, 0] + ch * laser[0] - sh * laser[1]
        laser_y = poses[i, 1] + sh * laser[0] + ch * laser[1]
        from_col = c * laser_x - s * laser_y + x0
        from_row = s * laser_x + c * laser_y + y0
        for j in range(i % stride, len(hits), stride):
            hit_x = poses[i, 0] + ch * hits[j, 0] - sh * hits[j, 1]
            hit_y = poses[i, 1] + sh * hits[j, 0] + ch * hits[j, 1]
            col = c * hit_x - s * hit_y + x0
            row = s * hit_x + c * hit_y + y0
            if not (0.0 <= col < cols and 0.0 <= row < rows):
                continue  # the rim has code 0
            code = codes[int(row) + 1, int(col) + 1]
            dx, dy = col - from_col, row - from_row
            share = 1.0 - margin / sqrt(dx * dx + dy * dy)  # of the ray that must be clear
            if not (code > 0 and share > 0.0):
                continue
            if always_meets(ahead, (from_col, from_row), (dx, dy), share):
                sums[i] += code * (log_step * stride)
    return sums


@kernel
def always_meets(
    jumps: FlatJumps, start: tuple[float, float], way: tuple[float, float], share: float
) -> bool:
    """Return whether a ray meets an obstacle, and so do rays turned slightly to either side."""
    dx, dy = way
    for c, s in _TURNS:
        dx, dy = c * dx - s * dy, s * dx + c * dy
        if not cast_ray(jumps, start[0], start[1], dx, dy, share) < share:
            return False
    return True
