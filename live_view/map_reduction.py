"""Reduces a large map for a browser, a few rows at a time."""

import zlib
from collections.abc import Iterator

import msgspec
import numpy as np
from numpy.typing import NDArray

from protocol.errors import MalformedMessageError
from protocol.steps import MapMessage

MAX_SIDE = 4096
"""Limit for the rows and for the columns of the page's map."""


def reduced(message: MapMessage) -> MapMessage:
    """Return the map with at most `MAX_SIDE` cells a side.

    A larger cell replaces a square of cells. It is occupied if any of them is occupied, and free
    if any is free but none occupied.

    Raises:
        MalformedMessageError: the packed cells are damaged or too few.
    """
    every = -(-max(message.rows, message.cols) // MAX_SIDE)
    if every <= 1:
        return message
    packer = zlib.compressobj(1)
    packed = [packer.compress(_small(band, every).tobytes()) for band in _bands(message, every)]
    rows, cols = -(-message.rows // every), -(-message.cols // every)
    return msgspec.structs.replace(
        message,
        rows=rows,
        cols=cols,
        cell_m=message.cell_m * every,
        zlib_cells=b"".join(packed) + packer.flush(),
    )


def _bands(message: MapMessage, every: int) -> Iterator[NDArray[np.int8]]:
    """Yield the map's rows from the lowest, `every` rows at a time; the last may be fewer."""
    unpacker, left = zlib.decompressobj(), message.zlib_cells
    for row in range(0, message.rows, every):
        size = min(every, message.rows - row) * message.cols
        pieces, have = [], 0
        while have < size:
            try:
                piece = unpacker.decompress(left, size - have)
            except zlib.error as error:
                raise MalformedMessageError(expected="map", problem=str(error)) from error
            left = unpacker.unconsumed_tail
            if not piece:
                raise MalformedMessageError(expected="map", problem="its bytes are too few")
            pieces.append(piece)
            have += len(piece)
        yield np.frombuffer(b"".join(pieces), np.int8).reshape(-1, message.cols)


def _small(band: NDArray[np.int8], every: int) -> NDArray[np.int8]:
    """Reduce a band to one row by maximum: unknown < free < occupied."""
    return np.maximum.reduceat(band.max(axis=0), np.arange(0, band.shape[1], every))
