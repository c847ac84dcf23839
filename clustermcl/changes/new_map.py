"""Puts changes into a map, and joins the changes that several robots have seen."""

import dataclasses
import zlib
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.changes import NEW, Changes
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.recordings.maps.grid_map import GridMap

_BEHIND = 2
"""Walls this near to one that is gone are unknown where no beam was [cells]."""


class OtherMapError(ClusterMclError):
    """Changes are of another map."""

    def __init__(self, *, expected: str, found: str) -> None:
        self.expected, self.found = expected, found
        super().__init__(f"changes of map {found:.12} do not belong to map {expected:.12}")


def joined(of_robots: Sequence[Changes]) -> Changes:
    """Return the changes that several robots have seen in one map: of each cell, the last sighting.

    Raises:
        OtherMapError: the robots have different maps.
    """
    first = of_robots[0]
    last_s = np.full(first.rows * first.cols, -np.inf)
    last_of = np.zeros(last_s.shape, np.int64)
    for number, each in enumerate(of_robots):
        if each.map_digest != first.map_digest:
            raise OtherMapError(expected=first.map_digest, found=each.map_digest)
        minute = each.seen_min().ravel()
        seen_s = np.where(minute > 0, 60.0 * (minute - 1), -np.inf)
        seen_s[each.cells.array()[:, 0]] = each.times_s.array()[:, 1]
        last_of[seen_s > last_s] = number
        np.maximum(last_s, seen_s, out=last_s)
    parts = [e.chosen(last_of[e.cells.array()[:, 0]] == n) for n, e in enumerate(of_robots)]
    cells, times_s = (
        np.concatenate([part.array() for part in column])
        for column in ([e.cells for e in parts], [e.times_s for e in parts])
    )
    order = np.argsort(cells[:, 0])
    seen_min = np.maximum.reduce([each.seen_min() for each in of_robots])
    return replace(
        max(of_robots, key=lambda each: each.stamp_ns),
        cells=ArrayBlob.of(cells[order], "int32"),
        times_s=ArrayBlob.of(times_s[order], "float64"),
        seen_share=max(each.seen_share for each in of_robots),
        zlib_seen_min=zlib.compress(seen_min.data),
    )


def with_changes(grid_map: GridMap, changes: Changes) -> GridMap:
    """Return a map with its changes put in.

    What is gone or moving becomes free, what is new occupied. What no beam has reached stays as
    mapped, except next to walls that are gone: that is unknown.

    Raises:
        OtherMapError: the changes are of another map.
    """
    if changes.map_digest != grid_map.digest:
        raise OtherMapError(expected=grid_map.digest, found=changes.map_digest)
    every = round(changes.cell_m / grid_map.cell_m)
    cells, kinds = changes.cells.array()[:, 0], changes.cells.array()[:, 1]
    marked = np.full((changes.rows, changes.cols), -1, np.int8)
    marked.flat[cells] = kinds
    now = np.full(marked.shape, OCCUPIED, np.int8)
    now[(marked >= 0) & (marked != NEW)] = FREE
    gone = np.pad((marked >= 0) & (marked != NEW), _BEHIND)
    shifts = np.ndindex(2 * _BEHIND + 1, 2 * _BEHIND + 1)
    rows, cols = marked.shape
    beside = np.logical_or.reduce([gone[i : i + rows, j : j + cols] for i, j in shifts])
    hidden = (marked < 0) & beside & (changes.seen_min() == 0)
    now[hidden] = UNKNOWN
    whole = np.ones((every, every), np.int8)
    height, width = grid_map.cells.shape
    fine = np.kron(now, whole)[:height, :width]
    is_changed = np.kron(((marked >= 0) | hidden).astype(np.int8), whole)[:height, :width] > 0
    is_changed &= (fine != UNKNOWN) | (grid_map.cells == OCCUPIED)
    made = np.where(is_changed, fine, grid_map.cells)
    return dataclasses.replace(grid_map, cells=made)
