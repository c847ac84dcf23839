"""Converts maps to and from the bridge's messages, and from those of robots and of ROS."""

import math
import zlib
from typing import Any

import numpy as np

from clustermcl.filter.arrays import Cells
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import MapMessage, MapReading
from clustermcl.recordings.maps.grid_map import (
    FREE_PERCENT,
    MAX_CELLS,
    OCCUPIED_PERCENT,
    GridMap,
    cells_of,
    known_part,
)


def to_message(grid_map: GridMap, sender: str) -> MapMessage:
    """Return a map as a message of the bridge, compressed by zlib, mostly to 1 %."""
    rows, cols = grid_map.cells.shape
    return MapMessage(
        sender=sender,
        digest=grid_map.digest,
        cell_m=grid_map.cell_m,
        map_from_grid=grid_map.map_from_grid,
        rows=rows,
        cols=cols,
        zlib_cells=zlib.compress(grid_map.cells.data, level=6),
        landmarks=grid_map.landmarks,
        floors=grid_map.floors,
    )


def from_message(message: MapMessage) -> GridMap:
    """Return the map of a message of the bridge.

    Raises:
        MalformedMessageError: the bytes are not a map, or do not match the digest.
    """
    rows, cols, size = message.rows, message.cols, message.rows * message.cols
    try:
        if rows < 1 or cols < 1 or size > MAX_CELLS:
            raise ValueError(f"{rows} x {cols} cells")
        unpacker = zlib.decompressobj()
        cells = unpacker.decompress(message.zlib_cells, size + 1)  # stops a decompression bomb
        if len(cells) != size or not unpacker.eof:
            raise ValueError(f"its bytes do not fill {rows} x {cols} cells")
        grid, place = np.frombuffer(cells, np.int8).reshape(rows, cols), message.map_from_grid
        grid_map = GridMap(grid, message.cell_m, place, message.landmarks, floors=message.floors)
    except (zlib.error, ValueError) as error:
        raise _malformed(str(error)) from error
    if grid_map.digest != message.digest:
        raise _malformed(f"its digest is {grid_map.digest:.12}, announced {message.digest:.12}")
    return grid_map


def from_reading(reading: MapReading) -> GridMap:
    """Return the map of a robot's message.

    Raises:
        MalformedMessageError: the fields are not a valid map, or no cell is free.
    """
    occupancy = reading.occupancy.array()
    try:
        if occupancy.dtype != np.int8:
            raise ValueError(f"{occupancy.dtype} of {occupancy.shape}, expected int8")
        return _published(occupancy, reading.cell_m, reading.map_from_grid)
    except ValueError as error:
        raise _malformed(str(error)) from error


def grid_map_of(message: Any) -> GridMap:
    """Return the map of a `nav_msgs/OccupancyGrid`.

    Raises:
        ValueError: the message is not a valid map, or no cell is free.
    """
    info, values = message.info, np.asarray(message.data, np.int8)
    if not 0 < info.width * info.height == len(values) <= MAX_CELLS:
        raise ValueError(f"{len(values)} cells for {info.width} x {info.height}")
    position, turn = info.origin.position, info.origin.orientation
    heading = 2.0 * math.atan2(turn.z, turn.w)
    origin = (position.x, position.y, math.remainder(heading, math.tau))
    # Take the shortest decimal, as in map files: 0.05, not 0.05000000074505806.
    cell_m = float(str(np.float32(info.resolution)))
    return _published(values.reshape(info.height, info.width), cell_m, origin)


def _published(occupancy: Cells, cell_m: float, map_from_grid: PoseTuple) -> GridMap:
    """Return the map of an occupancy [%], with a remark if it has probabilities."""
    grid_map = known_part(cells_of(occupancy), cell_m, map_from_grid)
    if not np.any((occupancy > 0) & (occupancy < 100)):
        return grid_map
    known = occupancy[(occupancy >= 0) & (occupancy <= 100)]
    free, occupied = np.sum(known <= FREE_PERCENT), np.sum(known >= OCCUPIED_PERCENT)
    how = f"{free} cells of up to {FREE_PERCENT} % are free, {occupied} from {OCCUPIED_PERCENT} %"
    between = len(known) - free - occupied
    remark = f"a map of probabilities: {how} occupied, {between} between are unknown"
    return grid_map.with_remarks(remark)


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(expected="map", problem=problem)
