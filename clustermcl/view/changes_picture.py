"""Draws what has changed in a building on its map."""

import numpy as np
from PIL import Image, ImageDraw

from clustermcl.filter.poses import compose
from clustermcl.protocol.changes import Changes
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.view.caption import Key, captioned
from clustermcl.view.drawing import View, map_canvas, smoothed

COLOURS = ("#c0262d", "#0072B2", "#E69F00")
"""Of what is gone, new and moving; the same as in `changes.js`."""
_WORDS = ("gone", "new", "moving")


def drawn_changes(grid_map: GridMap, changes: Changes, title: str) -> Image.Image:
    """Return a picture of the map with the changed cells."""
    canvas, view = map_canvas(grid_map)
    draw_changes(ImageDraw.Draw(canvas), view, changes)
    legend = (Key("disc", *named) for named in zip(COLOURS, _WORDS, strict=True))
    return smoothed(captioned(canvas, view.px_per_m, title, legend))


def draw_changes(draw: ImageDraw.ImageDraw, view: View, changes: Changes) -> None:
    cells = changes.cells.array()
    rows, cols = np.divmod(cells[:, 0], changes.cols)
    centres = np.column_stack([cols + 0.5, rows + 0.5, 0.0 * rows]) * changes.cell_m
    side = max(0.5 * changes.cell_m * view.px_per_m, 2.0)
    in_map = compose(np.array(changes.map_from_grid), centres)
    for (x_m, y_m, _), kind in zip(in_map.tolist(), cells[:, 1].tolist(), strict=True):
        x, y = view.at(x_m, y_m)
        draw.rectangle((x - side, y - side, x + side, y + side), fill=COLOURS[kind])
