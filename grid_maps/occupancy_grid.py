"""Maps of ROS as messages, and from bags.

Cells are read as AMCL does: 0 is free, 100 occupied, everything else unknown.
"""

import math
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

from grid_maps.grid_map import MAX_CELLS, GridMap
from grid_maps.known_part import known_part
from grid_maps.map_message import cells_of
from process_runtime.bag_file import OCCUPANCY_GRID, BagFile
from protocol.errors import MapFileError

_MAP = "map"
_TOPIC_MARK = "#"


def split_topic(path: Path) -> tuple[Path, str]:
    """File and topic of ``FILE#TOPIC``; a file without is itself."""
    if path.exists() or _TOPIC_MARK not in str(path):
        return path, ""
    file, _, topic = str(path).rpartition(_TOPIC_MARK)
    return Path(file), topic


def load_bag_map(path: Path, topic: str) -> GridMap:
    """The last map on a topic of a bag.

    Args:
        path: the bag.
        topic: its name; empty: the one that is called ``map``, in any namespace.

    Raises:
        MapFileError: the bag cannot be read, has no such map, or the choice is not made.
    """
    with BagFile(path, MapFileError) as bag:
        topics = bag.of_type(OCCUPANCY_GRID)
        held = ", ".join(topics) or "none"
        chosen = [one for one in topics if one == topic or (not topic and _is_map(one))]
        if len(chosen) != 1:
            problem = f"no map on {topic or 'a topic called map'}; it has nav_msgs/OccupancyGrid"
            problem += f" on: {held}"
            remedy = f"name a map file by --map, or one of these as --map {path}{_TOPIC_MARK}TOPIC"
            raise MapFileError(path, f"{problem}; {remedy}")
        sent = deque(bag.messages(chosen), maxlen=1)
        if not sent:
            raise MapFileError(path, f"{chosen[0]}: {bag.left_out[0].problem}")
    try:
        return grid_map_of(sent[0].content)
    except ValueError as problem:
        raise MapFileError(path, f"{chosen[0]}: {problem}") from problem


def _is_map(topic: str) -> bool:
    return topic.rpartition("/")[2] == _MAP


def grid_map_of(message: Any) -> GridMap:
    """A `nav_msgs/OccupancyGrid` as a map.

    Raises:
        ValueError: it is none, or has no free cell.
    """
    info, values = message.info, np.asarray(message.data, np.int8)
    if not 0 < info.width * info.height == len(values) <= MAX_CELLS:
        raise ValueError(f"{len(values)} cells for {info.width} x {info.height}")
    cells = cells_of(values)
    position, turn = info.origin.position, info.origin.orientation
    heading = 2.0 * math.atan2(turn.z, turn.w)
    origin = (position.x, position.y, math.remainder(heading, math.tau))
    # As a number with few digits, as map files have it: 0.05 and not 0.05000000074505806.
    cell_m = float(str(np.float32(info.resolution)))
    return known_part(cells.reshape(info.height, info.width), cell_m, origin)
