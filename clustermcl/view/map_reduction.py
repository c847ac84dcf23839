"""Reduces a large map for a browser."""

import zlib

import msgspec
import numpy as np

from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.steps import MapMessage
from clustermcl.recordings.maps.grid_map import coarse

MAX_SIDE = 4096
"""Limit for the rows and for the columns of the page's map."""


def reduced(message: MapMessage) -> MapMessage:
    """Return the map with at most `MAX_SIDE` cells a side, see `coarse`.

    Raises:
        MalformedMessageError: the packed cells are damaged or too few.
    """
    every, size = -(-max(message.rows, message.cols) // MAX_SIDE), message.rows * message.cols
    if every <= 1:
        return message
    try:
        packed = zlib.decompressobj().decompress(message.zlib_cells, size)
        cells = coarse(np.frombuffer(packed, np.int8).reshape(message.rows, message.cols), every)
    except (zlib.error, ValueError) as error:
        raise MalformedMessageError(expected="map", problem=str(error)) from error
    rows, cols = cells.shape
    return msgspec.structs.replace(
        message,
        rows=rows,
        cols=cols,
        cell_m=message.cell_m * every,
        zlib_cells=zlib.compress(cells.tobytes(), 1),
    )
