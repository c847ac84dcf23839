"""Converts maps to and from the bridge's messages, and from those of robots and of ROS."""

import math
import zlib
from typing import Any

import numpy as np

from clustermcl.filter.arrays import Cells
from clustermcl.protocol.errors import MalformedMessageError
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
    size = message.rows * message.cols
    if message.rows < 1 or message.cols < 1 or size > MAX_CELLS:
        raise _malformed(f"{message.rows} x {message.cols} cells")
    try:
        unpacker = zlib.decompressobj()
        cells = unpacker.decompress(message.zlib_cells, size + 1)  # stops a decompression bomb
        if len(cells) != size or not unpacker.eof:
            raise _malformed(f"its bytes do not fill {message.rows} x {message.cols} cells")
        grid = np.frombuffer(cells, np.int8).reshape(message.rows, message.cols)
        grid_map = GridMap(
            grid, message.cell_m, message.map_from_grid, message.landmarks, floors=message.floors
        )
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
    if occupancy.dtype != np.int8 or occupancy.ndim != 2:
        raise _malformed(f"{occupancy.dtype} of {occupancy.shape}, expected int8 of rows and cols")
    try:
        grid_map = known_part(cells_of(occupancy), reading.cell_m, reading.map_from_grid)
        return grid_map.with_remarks(_remark(occupancy))
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
    cells = cells_of(values)
    position, turn = info.origin.position, info.origin.orientation
    heading = 2.0 * math.atan2(turn.z, turn.w)
    origin = (position.x, position.y, math.remainder(heading, math.tau))
    # Take the shortest decimal, as in map files: 0.05, not 0.05000000074505806.
    cell_m = float(str(np.float32(info.resolution)))
    grid_map = known_part(cells.reshape(info.height, info.width), cell_m, origin)
    return grid_map.with_remarks(_remark(values))


def _remark(occupancy: Cells) -> str:
    """Return a remark on a map of probabilities, with the cells between the thresholds."""
    if not np.any((occupancy > 0) & (occupancy < 100)):
        return ""
    known = occupancy[(occupancy >= 0) & (occupancy <= 100)]
    free, occupied = np.sum(known <= FREE_PERCENT), np.sum(known >= OCCUPIED_PERCENT)
    how = f"{free} cells of up to {FREE_PERCENT} % are free, {occupied} from {OCCUPIED_PERCENT} %"
    between = len(known) - free - occupied
    return f"a map of probabilities: {how} occupied, {between} between are unknown"


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(expected="map", problem=problem)
