"""What a likelihood field does not see: beams that would have to pass through walls.

A field rewards a beam that ends near an obstacle, be there walls between or not; a wrong place
amid many walls therefore often scores better than the true one. Following the rays tells them
apart, at a hundred times the price, so it is done for a few particles of each cluster.
"""

from math import cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from particle_filter.arrays import LogWeights, Points, Poses
from particle_filter.kernels import ToCells, kernel, plain, read_only
from particle_filter.likelihood_field import LikelihoodField
from particle_filter.ray_casting import FlatJumps, JumpField, cast_ray, flat


def occluded_log_likelihood(
    map_from_robot: Poses,
    laser_in_robot: Points,
    hits_in_robot: Points,
    field: LikelihoodField,
    jumps: JumpField,
    margin_m: float,
    slack_rad: float,
    stride: int = 1,
) -> LogWeights:
    """What the field gave for beams whose end the laser could not have seen.

    A beam whose ray, and both neighbours of it, meet an occupied cell more than `margin_m`
    before its end is explained by nothing: it keeps the field's floor, and the rest of what it
    was given is returned.

    Args:
        map_from_robot: (N, 3) poses.
        laser_in_robot: (2,) where the rays start [m].
        hits_in_robot: (B, 2) where they ended [m].
        field: the map as `scan_log_likelihood` reads it.
        jumps: `ray_casting.jump_field` of the same map.
        margin_m: slack along the ray for the map's and the pose's error [m].
        slack_rad: slack across it: a ray along a wall may dip into it for metres when the pose is
            a little off, and then one of its neighbours does not [rad].
        stride: pose i answers for beams i, i + stride and so on, modulo `stride`, and counts them
            for all: poses of one cloud see much the same, and share the beams.

    Returns:
        (N,) to subtract from `scan_log_likelihood`; never negative.
    """
    return _hidden(
        plain(map_from_robot),
        plain(laser_in_robot),
        plain(hits_in_robot),
        field.codes,
        read_only(jumps),
        field.in_cells,
        (margin_m / field.cell_m, slack_rad, field.log_step),
        stride,
    )


@kernel
def _hidden(
    poses: Poses,
    laser: NDArray[np.float64],
    hits: Points,
    codes: NDArray[np.uint16],
    jumps: JumpField,
    in_cells: ToCells,
    numbers: tuple[float, float, float],
    stride: int,
) -> NDArray[np.float64]:
    """Numbers: `margin_m` in cells, `slack_rad` and the field's `log_step`."""
    (c, s, x0, y0), (margin, slack, log_step) = in_cells, numbers
    rows, cols = jumps.shape[1], jumps.shape[2]
    sums, ahead = np.zeros(len(poses)), flat(jumps)
    # The ray itself must meet something, and so must one a little to either side of it.
    turns = ((1.0, 0.0), (cos(slack), sin(slack)), (cos(-2.0 * slack), sin(-2.0 * slack)))
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
                continue  # the rim: nothing was given
            given = codes[int(row) + 1, int(col) + 1]
            dx, dy = col - from_col, row - from_row
            share = 1.0 - margin / sqrt(dx * dx + dy * dy)  # of the ray that must be clear
            if not (given > 0 and share > 0.0):
                continue
            if _always_meets(ahead, (from_col, from_row), (dx, dy), share, turns):
                sums[i] += given * (log_step * stride)
    return sums


@kernel
def _always_meets(
    jumps: FlatJumps,
    start: tuple[float, float],
    way: tuple[float, float],
    share: float,
    turns: tuple[tuple[float, float], ...],
) -> bool:
    """Whether a ray, turned by one after the other of `turns`, always meets something."""
    dx, dy = way
    for c, s in turns:
        dx, dy = c * dx - s * dy, s * dx + c * dy
        if not cast_ray(jumps, start[0], start[1], dx, dy, share) < share:
            return False
    return True
