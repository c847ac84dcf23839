"""Puts changes into a map, and joins the changes that several robots have seen."""

import dataclasses
import zlib
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.filter.laser.seen_cells import widened
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.changes import NEW, Changes
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.recordings.maps.grid_map import GridMap

_BEHIND = 2
"""Walls this near to one that is gone are unknown where no beam was [cells]."""
_AS_MAPPED = -2


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
    grid = first.map_digest, first.rows, first.cols
    for each in of_robots:
        if (each.map_digest, each.rows, each.cols) != grid:
            raise OtherMapError(expected=first.map_digest, found=each.map_digest)
    seen_min = np.array([each.seen_min() for each in of_robots])
    seen_s = np.where(seen_min > 0, 60.0 * (seen_min - 1), -np.inf).reshape(len(of_robots), -1)
    for of_robot, each in zip(seen_s, of_robots, strict=True):
        of_robot[each.cells.array()[:, 0]] = each.times_s.array()[:, 1]
    last = seen_s.argmax(axis=0)
    parts = [each.chosen(last[each.cells.array()[:, 0]] == n) for n, each in enumerate(of_robots)]
    cells = np.concatenate([part.cells.array() for part in parts])
    times_s = np.concatenate([part.times_s.array() for part in parts])
    order = np.argsort(cells[:, 0])
    return replace(
        max(of_robots, key=lambda each: each.stamp_ns),
        cells=ArrayBlob.of(cells[order], "int32"),
        times_s=ArrayBlob.of(times_s[order], "float64"),
        seen_share=max(each.seen_share for each in of_robots),
        zlib_seen_min=zlib.compress(seen_min.max(axis=0).data),
    )


def with_changes(grid_map: GridMap, changes: Changes) -> GridMap:
    """Return a map with its changes put in.

    What is gone or moving becomes free, what is new occupied. What no beam has reached stays as
    mapped, except next to walls that are gone: that is unknown.

    Raises:
        OtherMapError: the changes are of another map.
    """
    every = max(round(changes.cell_m / grid_map.cell_m), 1)
    row, col = (np.arange(side) // every for side in grid_map.cells.shape)
    of_map = grid_map.digest, row[-1] + 1, col[-1] + 1
    if (changes.map_digest, changes.rows, changes.cols) != of_map:
        raise OtherMapError(expected=grid_map.digest, found=changes.map_digest)
    cells, kinds = changes.cells.array()[:, 0], changes.cells.array()[:, 1]
    now = np.full((changes.rows, changes.cols), _AS_MAPPED, np.int8)
    now.flat[cells] = np.where(kinds == NEW, OCCUPIED, FREE)
    is_unseen = (now == _AS_MAPPED) & (changes.seen_min() == 0)
    now[is_unseen & widened(now == FREE, _BEHIND)] = UNKNOWN
    fine = now[np.ix_(row, col)]
    is_kept = (fine == _AS_MAPPED) | ((fine == UNKNOWN) & (grid_map.cells != OCCUPIED))
    return dataclasses.replace(grid_map, cells=np.where(is_kept, grid_map.cells, fine))
