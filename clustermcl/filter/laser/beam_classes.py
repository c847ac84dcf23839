"""Count the beams of a scan at one pose by class.

A short beam may end at a person, so it is no evidence about the place. A beam through a mapped
wall is evidence, for no person makes a beam longer. At the right place beams end *on* obstacles;
at wrong ones they end near obstacles by chance.
"""

from math import ceil, cos, floor, sin, sqrt

import numpy as np

from clustermcl.filter.arrays import OCCUPIED, UNKNOWN, Cells, Points, Pose
from clustermcl.filter.grid import Grid
from clustermcl.filter.kernels.compiled import ToCells, kernel, plain, read_only
from clustermcl.filter.laser.off_map import BeamClasses
from clustermcl.filter.laser.ray_casting import JumpField, cast_ray, flat
from clustermcl.filter.laser.sensor_model import Beams

SHARP_M = 0.1
"""An end lies on an obstacle within this distance plus half a cell of the map [m]."""
NEAR_M = 0.3
"""An end is near an obstacle within this distance [m]."""
CLOSE_M = 2.0
"""Beams just before an obstacle closer than this may end at a person [m]."""
THROUGH_M = 0.45
"""A beam went through an obstacle if it ends this far behind the first on its way [m]."""


def beam_classes(map_from_robot: Pose, beams: Beams, grid: Grid, jumps: JumpField) -> BeamClasses:
    """Return the number of beams of a scan in each class at a (3,) pose."""
    counts = np.zeros(4, np.int64)
    for laser in beams.lasers:
        _count(
            plain(map_from_robot),
            plain(laser.robot_from_laser),
            plain(laser.own_hits_in_robot[laser.ranges < laser.max_range_m]),
            grid.cells,
            read_only(jumps),
            grid.in_cells,
            grid.cell_m,
            counts,
        )
    return BeamClasses(*counts.tolist())


@kernel
def _count(
    pose: Pose,
    laser: Pose,
    hits: Points,
    cells: Cells,
    jumps: JumpField,
    in_cells: ToCells,
    cell_m: float,
    counts: np.ndarray,
) -> None:
    (c, s, x0, y0), ahead = in_cells, flat(jumps)
    rows, cols = cells.shape
    ch, sh = cos(pose[2]), sin(pose[2])
    laser_x = pose[0] + ch * laser[0] - sh * laser[1]
    laser_y = pose[1] + sh * laser[0] + ch * laser[1]
    from_col, from_row = c * laser_x - s * laser_y + x0, s * laser_x + c * laser_y + y0
    sharp, near, behind = SHARP_M / cell_m + 0.5, NEAR_M / cell_m, THROUGH_M / cell_m
    close = CLOSE_M / cell_m
    reach = ceil(max(sharp, near))
    for j in range(len(hits)):
        hit_x = pose[0] + ch * hits[j, 0] - sh * hits[j, 1]
        hit_y = pose[1] + sh * hits[j, 0] + ch * hits[j, 1]
        dx = c * hit_x - s * hit_y + x0 - from_col
        dy = s * hit_x + c * hit_y + y0 - from_row
        length = sqrt(dx * dx + dy * dy)
        if not length > 0.0:
            counts[3] += 1
            continue
        first = cast_ray(ahead, from_col, from_row, dx, dy, 1.0)
        known = True
        for k in range(int(min(first, 1.0) * length)):
            col, row = floor(from_col + dx * k / length), floor(from_row + dy * k / length)
            if not (0 <= col < cols and 0 <= row < rows) or cells[int(row), int(col)] == UNKNOWN:
                known = False
                break
        if not known:
            counts[3] += 1
        elif length * (1.0 - first) > behind:
            counts[2] += 1
        else:
            # Distances are between centres of cells, as in the likelihood field.
            col, row, least = floor(from_col + dx), floor(from_row + dy), np.inf
            for at_row in range(max(row - reach, 0), min(row + reach + 1, rows)):
                for at_col in range(max(col - reach, 0), min(col + reach + 1, cols)):
                    if cells[at_row, at_col] == OCCUPIED:
                        least = min(least, (at_row - row) ** 2 + (at_col - col) ** 2)
            away = sqrt(least)
            is_near = away <= near
            if (
                is_near and not away < sharp and first > 1.0
            ):  # just before a close obstacle on its way
                is_near = cast_ray(ahead, from_col, from_row, dx, dy, close / length) == np.inf
            counts[0 if away < sharp else 1 if is_near else 3] += 1
