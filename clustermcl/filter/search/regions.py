"""Named parts of a map: floors, halls, wings."""

import numpy as np
from numpy.typing import NDArray

from clustermcl.filter.arrays import Pose
from clustermcl.filter.poses import between

Corners = tuple[tuple[float, float], ...]
"""Corners (x [m], y [m]) in the map: two opposite ones of a rectangle, or all of a polygon."""


def parsed_regions(text: str) -> dict[str, Corners]:
    """Parse the checked setting `search.regions`; return the corners by name."""
    regions = {}
    for region in filter(str.strip, text.split(";")):
        name, _, corners = region.partition(":")
        pairs = [corner.split() for corner in corners.split(",")]
        regions[name.strip()] = tuple((float(x), float(y)) for x, y in pairs)
    return regions


def is_region(
    corners: Corners, shape: tuple[int, ...], side_m: float, map_from_grid: Pose
) -> NDArray[np.bool_]:
    """Return (rows, cols) whether the centre of each tile lies in a region of the map.

    `map_from_grid` is the (3,) outer corner of tile (0, 0).
    """
    if len(corners) == 2:
        (left, low), (right, high) = corners
        corners = ((left, low), (right, low), (right, high), (left, high))
    points = np.array([(x, y, 0.0) for x, y in corners])
    in_grid = between(map_from_grid, points)[:, :2]
    y = ((np.arange(shape[0]) + 0.5) * side_m)[:, None]
    x = (np.arange(shape[1]) + 0.5) * side_m
    inside = np.zeros(shape, bool)
    for (x0, y0), (x1, y1) in zip(in_grid, np.roll(in_grid, -1, axis=0), strict=True):
        if y0 == y1:
            continue
        # Even-odd rule: each edge to the right of a point toggles whether it is inside.
        inside ^= ((y0 > y) != (y1 > y)) & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside
