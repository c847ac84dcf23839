"""How well each beam of a scan fits the map at one pose: a byte for each beam."""

from math import cos, sin, sqrt

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Points, Pose
from clustermcl.filter.kernels.compiled import ToCells, kernel, plain, read_only
from clustermcl.filter.laser.pyramid import Level
from clustermcl.filter.laser.ray_casting import FlatJumps, JumpField, cast_ray, flat
from clustermcl.filter.laser.sensor_model import Beams, SensorModel

THROUGH_M, BESIDE_RAD = 0.45, 0.05
"""A beam goes through a wall if it ends this far behind the first obstacle on its ray [m], and so
do rays turned by this to either side [rad]. Map and pose have errors: if the heading is slightly
wrong, a ray along a wall may enter it for metres, but those beside it do not."""
_TURNS = tuple((cos(turn), sin(turn)) for turn in (0.0, BESIDE_RAD, -2.0 * BESIDE_RAD))
"""Cosine and sine of the turns to a ray itself, and then to one on either side."""
_THROUGH = 1
"""The lowest bit of a fit."""


def beam_fits(map_from_robot: Pose, beams: Beams, model: SensorModel, *, mirrored: bool) -> bytes:
    """Return the fit of each beam at a (3,) pose.

    Seven bits of a byte are the beam's log-likelihood in the field, from that of an end far from
    all obstacles (0) to that of one on an obstacle (127). The lowest bit is 1 for a beam through a
    wall (`THROUGH_M`). The beams of mirrored scans are in the order of those that they mirror.
    """
    grid, level = model.grid, model.pyramid.levels[-1]
    parts = []
    for laser in beams.lasers:
        fits = np.zeros(len(laser.ranges), np.uint8)
        _fit(
            plain(map_from_robot),
            plain(laser.robot_from_laser),
            plain(laser.own_hits_in_robot),
            read_only(level),
            read_only(model.jumps),
            grid.in_cells,
            THROUGH_M / grid.cell_m,
            fits,
        )
        parts.append(fits[::-1] if mirrored else fits)
    return np.concatenate(parts).tobytes()


def decoded(fits: bytes) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return (B,) fits of beams, 0 to 1, and whether each goes through a wall."""
    codes = np.frombuffer(fits, np.uint8)
    return (codes >> 1) / 127.0, (codes & _THROUGH) != 0


@kernel
def _fit(
    pose: Pose,
    laser: Pose,
    hits: Points,
    level: Level,
    jumps: JumpField,
    in_cells: ToCells,
    margin: float,
    fits: NDArray[np.uint8],
) -> None:
    (c, s, x0, y0), ahead = in_cells, flat(jumps)
    rows, cols = jumps.shape[1], jumps.shape[2]
    side = level.shape[0]
    ch, sh = cos(pose[2]), sin(pose[2])
    laser_x = pose[0] + ch * laser[0] - sh * laser[1]
    laser_y = pose[1] + sh * laser[0] + ch * laser[1]
    from_col, from_row = c * laser_x - s * laser_y + x0, s * laser_x + c * laser_y + y0
    for j in range(len(hits)):
        hit_x = pose[0] + ch * hits[j, 0] - sh * hits[j, 1]
        hit_y = pose[1] + sh * hits[j, 0] + ch * hits[j, 1]
        to_col, to_row = c * hit_x - s * hit_y + x0, s * hit_x + c * hit_y + y0
        code = 0
        if 0.0 <= to_col < cols and 0.0 <= to_row < rows:
            # The finest level has the field at the centres of leaves: see `Pyramid`.
            row, col = int(to_row) - side // 2 + side, int(to_col) - side // 2 + side
            code = int(level[row % side, col % side, row // side, col // side])
        dx, dy = to_col - from_col, to_row - from_row
        share = 1.0 - margin / sqrt(dx * dx + dy * dy)  # of the ray that must be clear
        code &= 0xFE
        if share > 0.0 and _all_meet(ahead, (from_col, from_row), (dx, dy), share):
            code |= _THROUGH
        fits[j] = code


@kernel
def _all_meet(
    jumps: FlatJumps, start: tuple[float, float], way: tuple[float, float], share: float
) -> bool:
    """Return whether a ray meets an obstacle, and so do rays turned slightly to either side."""
    dx, dy = way
    for c, s in _TURNS:
        dx, dy = c * dx - s * dy, s * dx + c * dy
        if not cast_ray(jumps, start[0], start[1], dx, dy, share) < share:
            return False
    return True
