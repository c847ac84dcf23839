"""`clustermcl check --report`: a picture of the map with its look-alike places."""

from pathlib import Path
from typing import Any

from clustermcl.evaluation.map_check.report import MapReport, Place
from clustermcl.protocol.changes import Changes
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.view.plots import draw_arrows, draw_changes, draw_map, new_figure

UNIQUE, ALIKE, LANDMARK = "#009E73", "#E69F00", "#0072B2"
"""Colours of tested places, and of landmarks."""
_ARROW = 90.0


def drawn_report(report: MapReport, grid_map: GridMap, changes: Changes | None = None) -> Any:
    """Return a figure: tested places as filled arrows, joined with their look-alikes.

    A diamond is a landmark.
    """
    figure = new_figure()
    (axes,) = figure.axes
    draw_map(axes, grid_map)
    if changes is not None:
        draw_changes(axes, changes)
    for place in sorted(report.places, key=lambda place: len(place.look_alikes)):
        _draw_place(axes, place)
    for landmark in grid_map.landmarks:
        axes.plot(landmark.x, landmark.y, "D", color=LANDMARK, label="landmark")
    unique = sum(not place.look_alikes for place in report.places)
    axes.set_title(f"{Path(report.map).name}: {unique} of {len(report.places)} places are unique")
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    figure.legend(handles.values(), handles, loc="outside lower center", ncols=2)
    return figure


def _draw_place(axes: Any, place: Place) -> None:
    words, colour = ("others look alike", ALIKE) if place.look_alikes else ("unique place", UNIQUE)
    for other in place.look_alikes:
        axes.plot((place.pose[0], other[0]), (place.pose[1], other[1]), color=colour, alpha=0.3)
    alike = {"facecolor": "none", "edgecolor": colour, "label": "looks like the other end"}
    draw_arrows(axes, place.look_alikes, _ARROW, **alike)
    draw_arrows(axes, [place.pose], _ARROW, color=colour, label=words)
