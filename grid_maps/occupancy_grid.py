"""Converts ROS map messages.

Cells are read as AMCL does: 0 is free, 100 occupied, everything else unknown.
"""

import math
from typing import Any

import numpy as np

from grid_maps.grid_map import MAX_CELLS, GridMap
from grid_maps.known_part import known_part
from grid_maps.map_message import cells_of


def grid_map_of(message: Any) -> GridMap:
    """Convert a `nav_msgs/OccupancyGrid`.

    Raises:
        ValueError: it is not a map, or has no free cell.
    """
    info, values = message.info, np.asarray(message.data, np.int8)
    if not 0 < info.width * info.height == len(values) <= MAX_CELLS:
        raise ValueError(f"{len(values)} cells for {info.width} x {info.height}")
    cells = cells_of(values)
    position, turn = info.origin.position, info.origin.orientation
    heading = 2.0 * math.atan2(turn.z, turn.w)
    origin = (position.x, position.y, math.remainder(heading, math.tau))
    # The shortest decimal, as in map files: 0.05 and not 0.05000000074505806.
    cell_m = float(str(np.float32(info.resolution)))
    return known_part(cells.reshape(info.height, info.width), cell_m, origin)
