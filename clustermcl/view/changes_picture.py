"""Draws what has changed in a building on its map."""

from collections.abc import Iterator

import numpy as np
from PIL import Image, ImageDraw

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
    return smoothed(captioned(canvas, view.px_per_m, title, keys_of(changes)))


def keys_of(changes: Changes | None) -> Iterator[Key]:
    """Yield the legend of the kinds that there are."""
    for kind in [] if changes is None else np.unique(changes.cells.array()[:, 1]).tolist():
        yield Key("disc", COLOURS[kind], _WORDS[kind])


def draw_changes(draw: ImageDraw.ImageDraw, view: View, changes: Changes) -> None:
    side, kinds = max(0.5 * changes.cell_m * view.px_per_m, 2.0), changes.cells.array()[:, 1]
    for (x_m, y_m), kind in zip(changes.centres_m().tolist(), kinds.tolist(), strict=True):
        x, y = view.at(x_m, y_m)
        draw.rectangle((x - side, y - side, x + side, y + side), fill=COLOURS[kind])
