"""Draws what has changed in a building on its map."""

from typing import Any

import numpy as np

from clustermcl.protocol.changes import Changes
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.view.plots import draw_map, new_figure

COLOURS = ("#c0262d", "#0072B2", "#E69F00")
"""Of what is gone, new and moving; the same as in `changes.js`."""
_WORDS = ("gone", "new", "moving")


def drawn_changes(grid_map: GridMap, changes: Changes, title: str) -> Any:
    """Return a figure of the map with the changed cells."""
    figure = new_figure()
    (axes,) = figure.axes
    draw_map(axes, grid_map)
    draw_changes(axes, changes)
    axes.set_title(title)
    if axes.get_legend_handles_labels()[0]:  # there are changes
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def draw_changes(axes: Any, changes: Changes) -> None:
    """Draw the changed cells in the colour of their kind."""
    centres, kinds = changes.centres_m(), changes.cells.array()[:, 1]
    for kind in np.unique(kinds).tolist():
        x, y = centres[kinds == kind].T
        axes.plot(x, y, "s", color=COLOURS[kind], markersize=2, label=_WORDS[kind])
