"""A map on the wire: packed by the bridge, unpacked and checked by whoever asked."""

import zlib

import numpy as np

from grid_maps.grid_map import MAX_CELLS, GridMap
from protocol.errors import MalformedMessageError
from protocol.steps import MapMessage


def to_message(grid_map: GridMap, sender: str) -> MapMessage:
    """Pack a map; most are so empty that zlib makes 1 % of them."""
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
    """Unpack a map.

    Raises:
        MalformedMessageError: the bytes are no map, or not the one that the digest names.
    """
    size = message.rows * message.cols
    if message.rows < 1 or message.cols < 1 or size > MAX_CELLS:
        raise _malformed(f"{message.rows} x {message.cols} cells")
    try:
        unpacker = zlib.decompressobj()
        cells = unpacker.decompress(message.zlib_cells, size + 1)  # no more, whatever was packed
        if len(cells) != size or not unpacker.eof:
            raise _malformed(f"its bytes do not fill {message.rows} x {message.cols} cells")
        grid = np.frombuffer(cells, np.int8).reshape(message.rows, message.cols)
        grid_map = GridMap(grid, message.cell_m, message.map_from_grid)
    except (zlib.error, ValueError) as error:
        raise _malformed(str(error)) from error
    if grid_map.digest != message.digest:
        raise _malformed(f"its digest is {grid_map.digest:.12}, announced {message.digest:.12}")
    return grid_map


def _malformed(problem: str) -> MalformedMessageError:
    return MalformedMessageError(expected="map", problem=problem)
