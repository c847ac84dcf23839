"""Eight identical rooms: eight places remain possible, however long the robot drives.

A cluster that is lost or duplicated therefore always shows. Where places can be distinguished, the
number of clusters depends on chance.
"""

from math import hypot

import numpy as np

from clustermcl.protocol.message import PoseTuple
from clustermcl.runtime.sources import Simulated
from clustermcl.simulator.worlds.catalogue import simulated_world
from clustermcl.simulator.worlds.world import Canvas, World, world_from_map

COLUMNS, ROWS = 4, 2
PLACES = COLUMNS * ROWS
_WIDTH_M, _HEIGHT_M = 6.0, 5.0
_GAP_M = 0.5
_START = (1.0, 1.0, 0.0)
"""Start pose relative to the first room's lower left corner."""


def eight_rooms() -> World:
    plan = Canvas(COLUMNS * (_WIDTH_M + _GAP_M) + 1.0, ROWS * (_HEIGHT_M + _GAP_M) + 1.0)
    corners = [_corner(number) for number in range(PLACES)]
    for x, y in corners:
        plan.floor(x, y, x + _WIDTH_M, y + _HEIGHT_M)
    plan.add_walls()
    for x, y in corners:
        plan.block(x + 2.4, y + 1.6, x + 2.8, y + 2.0)  # a pillar
        plan.block(x, y + 3.9, x + 1.5, y + _HEIGHT_M)  # a cabinet
        plan.block(x + 4.2, y, x + 5.0, y + 0.5)  # a chest
        plan.block(x + 5.5, y + 3.0, x + _WIDTH_M, y + 3.8)  # a shelf
    x, y = corners[0]
    return world_from_map(plan.grid_map(), start=(x + _START[0], y + _START[1], _START[2]))


def soak_world(name: str) -> World:
    return eight_rooms() if name == eight_rooms.__name__ else simulated_world(Simulated(name))


def copies_in_all_rooms(map_from_robot: PoseTuple) -> tuple[PoseTuple, ...]:
    """Return the equivalent poses in all rooms, including the robot's own pose."""
    x, y, heading = map_from_robot
    corners = [_corner(number) for number in range(PLACES)]
    own_x, own_y = min(
        corners,
        key=lambda corner: hypot(corner[0] + _WIDTH_M / 2 - x, corner[1] + _HEIGHT_M / 2 - y),
    )
    return tuple((x - own_x + left, y - own_y + low, heading) for left, low in corners)


def _corner(number: int) -> tuple[float, float]:
    row, column = divmod(number, COLUMNS)
    low = np.array([COLUMNS * (_WIDTH_M + _GAP_M), ROWS * (_HEIGHT_M + _GAP_M)]) / -2.0
    x, y = low + np.array([column * (_WIDTH_M + _GAP_M), row * (_HEIGHT_M + _GAP_M)]) + _GAP_M / 2
    return float(x), float(y)
