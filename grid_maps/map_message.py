"""The map on the wire: published by robots, and served in compressed form by the bridge."""

import zlib

import numpy as np

from grid_maps.grid_map import MAX_CELLS, GridMap
from grid_maps.known_part import known_part
from particle_filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from protocol.errors import MalformedMessageError
from protocol.steps import MapMessage, MapReading


def to_message(grid_map: GridMap, sender: str) -> MapMessage:
    """Compress a map; zlib reduces most maps to 1 %."""
    rows, cols = grid_map.cells.shape
    return MapMessage(
        sender=sender,
        digest=grid_map.digest,
        cell_m=grid_map.cell_m,
        map_from_grid=grid_map.map_from_grid,
        rows=rows,
        cols=cols,
        zlib_cells=zlib.compress(grid_map.cells.data, level=6),
    )


def from_message(message: MapMessage) -> GridMap:
    """Decompress a map.

    Raises:
        MalformedMessageError: the bytes are not a map, or do not match the digest.
    """
    size = message.rows * message.cols
    if message.rows < 1 or message.cols < 1 or size > MAX_CELLS:
        raise _malformed(f"{message.rows} x {message.cols} cells")
    try:
        unpacker = zlib.decompressobj()
        cells = unpacker.decompress(message.zlib_cells, size + 1)  # bounds a decompression bomb
        if len(cells) != size or not unpacker.eof:
            raise _malformed(f"its bytes do not fill {message.rows} x {message.cols} cells")
        grid = np.frombuffer(cells, np.int8).reshape(message.rows, message.cols)
        grid_map = GridMap(grid, message.cell_m, message.map_from_grid)
    except (zlib.error, ValueError) as error:
        raise _malformed(str(error)) from error
    if grid_map.digest != message.digest:
        raise _malformed(f"its digest is {grid_map.digest:.12}, announced {message.digest:.12}")
    return grid_map


def from_reading(reading: MapReading) -> GridMap:
    """Convert the map that a robot publishes.

    Raises:
        MalformedMessageError: it is not a map, or has no free cell.
    """
    occupancy = reading.occupancy.array()
    if occupancy.dtype != np.int8 or occupancy.ndim != 2:
        raise _malformed(f"{occupancy.dtype} of {occupancy.shape}, expected int8 of rows and cols")
    try:
        return known_part(cells_of(occupancy), reading.cell_m, reading.map_from_grid)
    except ValueError as error:
        raise _malformed(str(error)) from error


def cells_of(occupancy: Cells) -> Cells:
    """Convert ROS occupancy as AMCL does: 0 is free, 100 occupied, everything else unknown."""
    cells = np.full(occupancy.shape, UNKNOWN, np.int8)
    cells[occupancy == 0] = FREE
    cells[occupancy == 100] = OCCUPIED
    return cells


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(expected="map", problem=problem)
