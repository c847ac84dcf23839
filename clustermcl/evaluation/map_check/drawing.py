"""`clustermcl check --report`: a picture of the map with its look-alike places."""

from pathlib import Path
from typing import Any

from clustermcl.evaluation.map_check.report import MapReport, Place
from clustermcl.protocol.changes import Changes
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.view.plots import INK, draw_arrows, draw_changes, draw_map, new_figure

COLOURS = ((0, "#009E73"), (1, "#F0E442"), (3, "#E69F00"), (10**9, "#c0262d"))
"""Colour of a tested place by the largest number of places that look like it."""
LANDMARK = "#0072B2"
_COUNTED = ("unique place", "one place looks alike", "2 or 3 look alike", "more look alike")
_ARROW = 90.0
_MANY = 8


def drawn_report(report: MapReport, grid_map: GridMap, changes: Changes | None = None) -> Any:
    """Return a figure: tested places as filled arrows, joined with their look-alikes.

    A diamond is a landmark. A circle around a place: no drive distinguishes it from its
    look-alikes.
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
    words, colour = next(
        (words, colour)
        for words, (most, colour) in zip(_COUNTED, COLOURS, strict=True)
        if len(place.look_alikes) <= most
    )
    x, y, _ = place.pose
    for other in place.look_alikes:
        alpha = 0.4 if len(place.look_alikes) < _MANY else 0.15
        axes.plot((x, other[0]), (y, other[1]), color=colour, alpha=alpha)
    alike = {"facecolor": "none", "edgecolor": colour, "label": "looks like the other end"}
    draw_arrows(axes, place.look_alikes, _ARROW, **alike)
    draw_arrows(axes, [place.pose], _ARROW, color=colour, label=words)
    if place.distinguishable is False:
        ring = "alike wherever the robot drives"
        axes.plot(x, y, "o", mfc="none", mec=INK, markersize=16, label=ring)
