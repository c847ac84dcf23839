"""What has changed in the building since it was mapped, as cells of a coarse grid over the map."""

import math
import zlib
from typing import Annotated, ClassVar

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import (
    LARGEST_BYTES,
    Message,
    PoseTuple,
    Positive,
    Probability,
    Stamp,
)

GONE, NEW, MOVED = 0, 1, 2
"""Kinds of a cell: beams pass the map's obstacle; beams end where the map is free; both in turn."""
MOST_CELLS = 2**24
"""Limit for the cells of the coarse grid."""


class Changes(Message, frozen=True, kw_only=True, tag="changes/1"):
    """The cells that are not as mapped, collected while the robot was localized.

    Published by the bridge on ``changes`` when it has changed; answers queries there.
    """

    max_bytes: ClassVar[int] = LARGEST_BYTES
    map_digest: str
    stamp_ns: Stamp
    """Robot's clock at the last step."""
    cell_m: Positive
    """Side of a cell of the coarse grid [m]."""
    rows: int
    cols: int
    map_from_grid: PoseTuple
    """Pose of the low corner of cell [0, 0] in the map."""
    cells: ArrayBlob
    """(N, 4) int32 in rising order of the first: row * cols + col; kind (`GONE`, `NEW`, `MOVED`);
    number of scans that showed the cell so; number of changes of the cell."""
    times_s: ArrayBlob
    """(N, 2) float64 robot's clock when the cell was first and last seen so [s]."""
    seen_share: Probability = 0.0
    """Share of the map's free cells that were seen in the last seven days."""
    zlib_seen_min: bytes = b""
    """zlib of rows x cols int32: minute of the robot's clock, from 1 on, when a beam last passed or
    hit each cell; 0: never. Empty in publications."""

    @property
    def problem(self) -> str | None:
        """Why the cells are invalid; None: they are valid, or a `MalformedMessageError`."""
        size = self.rows * self.cols
        if not (self.rows > 0 and self.cols > 0 and size <= MOST_CELLS):
            return f"{self.rows} x {self.cols} cells"
        cells = self.cells.checked(None, 4, dtype="int32")
        self.times_s.checked(len(cells), 2, dtype="float64")
        at, kinds = cells[:, 0], cells[:, 1]
        is_ordered = (np.diff(at) > 0).all() and (at >= 0).all() and (at < size).all()
        is_sound = is_ordered and (kinds <= MOVED).all() and (cells >= 0).all()
        return None if is_sound else "cells outside the grid, in no order, or of no kind"

    def __repr__(self) -> str:
        gone, new, moving = self.area_m2
        return f"<Changes: {gone:.2f} m² gone, {new:.2f} m² new, {moving:.2f} m² moving>"

    @property
    def area_m2(self) -> tuple[float, float, float]:
        """Area of the cells of each kind [m²]."""
        counts = np.bincount(self.cells.array()[:, 1], minlength=3) * self.cell_m**2
        gone, new, moved = counts.tolist()
        return gone, new, moved

    def seen_min(self) -> NDArray[np.int32]:
        """Return (rows, cols) when each cell was last seen, or 0; errors as `unpacked_minutes`."""
        shape, packed = (self.rows, self.cols), self.zlib_seen_min
        return unpacked_minutes(packed, shape) if packed else np.zeros(shape, np.int32)

    def centres_m(self) -> NDArray[np.float64]:
        """Return the (N, 2) centres of the cells in the map [m]."""
        row, col = np.divmod(self.cells.array()[:, 0], self.cols)
        in_grid = np.column_stack([col + 0.5, row + 0.5]) * self.cell_m
        x, y, heading = self.map_from_grid
        c, s = math.cos(heading), math.sin(heading)
        return np.asarray(in_grid @ np.array([[c, s], [-s, c]]) + (x, y))

    def chosen(self, kept: NDArray[np.bool_]) -> "Changes":
        """Return some of the cells."""
        return msgspec.structs.replace(
            self,
            cells=ArrayBlob.of(self.cells.array()[kept], "int32"),
            times_s=ArrayBlob.of(self.times_s.array()[kept], "float64"),
        )

    def seen_within(self, age_s: float) -> "Changes":
        """Return the cells that were last seen so within this time [s]."""
        return self.chosen(self.times_s.array()[:, 1] >= self.stamp_ns * 1e-9 - age_s)


def unpacked_minutes(packed: bytes, shape: tuple[int, ...]) -> NDArray[np.int32]:
    """Return an array of minutes that zlib has packed; or raise a `MalformedMessageError`."""
    size = 4 * math.prod(shape)
    try:
        unpacker = zlib.decompressobj()
        data = unpacker.decompress(packed, size + 1)  # stops a decompression bomb
    except zlib.error as error:
        raise MalformedMessageError(expected="Changes", problem=str(error)) from error
    if len(data) != size or not unpacker.eof:
        problem = f"its bytes do not fill {shape} cells"
        raise MalformedMessageError(expected="Changes", problem=problem)
    return np.frombuffer(data, "<i4").reshape(shape)


class KeptChanges(Message, frozen=True, kw_only=True, tag="kept_changes/1"):
    """All that was collected of one map, in a file: see `ChangeCollector.kept`."""

    max_bytes: ClassVar[int] = LARGEST_BYTES
    map_digest: str
    """`GridMap.cells_digest`."""
    layout: str
    """The fields of a record; records of another version are not used."""
    records: bytes
    trusted: bytes
    zlib_seen_min: bytes
    trusted_min: Annotated[int, Meta(ge=1)] = 1
    """When `trusted` was collected, as in `zlib_seen_min`."""
