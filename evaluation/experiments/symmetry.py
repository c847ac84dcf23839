"""Places that look like the true one: its images when a symmetric map is turned."""

import math

import numpy as np

from grid_maps.grid_map import GridMap
from particle_filter.poses import compose, wrap_angle
from protocol.message import PoseTuple

Point = tuple[float, float]
"""x [m], y [m]."""


def middle_of(grid_map: GridMap) -> Point:
    """The middle of the grid in the map frame, about which the simulated worlds are symmetric."""
    width_m, height_m = grid_map.size_m
    middle = np.array([width_m / 2, height_m / 2, 0.0])
    x, y, _ = compose(np.array(grid_map.map_from_grid), middle)
    return float(x), float(y)


def turned_copies(pose: PoseTuple, times: int, middle: Point) -> tuple[PoseTuple, ...]:
    """A pose and its images after turns of the whole map by 1 / `times` of a full turn.

    Args:
        pose: the true one; it comes first.
        times: of the symmetry; 1: there is nothing but the pose itself.
        middle: about which the map is turned.
    """
    x, y, heading = pose[0] - middle[0], pose[1] - middle[1], pose[2]
    copies = [pose]
    for turn in range(1, times):
        angle = math.tau * turn / times
        c, s = math.cos(angle), math.sin(angle)
        copies.append(
            (middle[0] + c * x - s * y, middle[1] + s * x + c * y, wrap_angle(heading + angle))
        )
    return tuple(copies)
