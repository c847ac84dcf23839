"""`clustermcl check --report`: a picture of the map with its look-alike places."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from clustermcl.evaluation.map_check.report import MapReport, Place
from clustermcl.filter.poses import compose
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.view.caption import INK, Key, captioned
from clustermcl.view.changes_picture import draw_changes, keys_of
from clustermcl.view.drawing import View, map_canvas, smoothed

COLOURS = ((0, "#009E73"), (1, "#F0E442"), (3, "#E69F00"), (10**9, "#c0262d"))
"""Colour of a tested place by the largest number of places that look like it."""
LANDMARK = "#0072B2"
_COUNTED = ("unique place", "one place looks alike", "2 or 3 look alike", "more look alike")
_ARROW_PX, _LINE_PX, _LANDMARK_PX = 18, 6, 16
_MANY = 8


def drawn_report(
    report: MapReport,
    grid_map: GridMap,
    landmarks: Sequence[Landmark] = (),
    changes: Changes | None = None,
) -> Image.Image:
    """Draw tested places as filled arrows, joined with their look-alikes.

    A diamond is a landmark. A circle around a place: no drive distinguishes it from its
    look-alikes.
    """
    canvas, view = map_canvas(grid_map)
    draw = ImageDraw.Draw(canvas, "RGBA")
    if changes is not None:
        draw_changes(draw, view, changes)
    for place in sorted(report.places, key=lambda place: len(place.look_alikes)):
        _draw_place(draw, view, place)
    for landmark in landmarks:
        square = (*view.at(landmark.x, landmark.y), _LANDMARK_PX)
        draw.regular_polygon(square, 4, rotation=45, fill=LANDMARK)
    unique = sum(not place.look_alikes for place in report.places)
    title = f"{Path(report.map).name}: {unique} of {len(report.places)} places are unique"
    legend = [*_legend(report.places, has_landmarks=bool(landmarks)), *keys_of(changes)]
    return smoothed(captioned(canvas, view.px_per_m, title, legend))


def _legend(places: Sequence[Place], *, has_landmarks: bool) -> Iterator[Key]:
    """Yield what the picture shows."""
    drawn = {_colour(place) for place in places}
    for words, (_, colour) in zip(_COUNTED, COLOURS, strict=True):
        if colour in drawn:
            yield Key("arrow", colour, words)
    if any(place.look_alikes for place in places):
        yield Key("outlined arrow", INK, "looks like the place at the other end")
    if any(place.distinguishable is False for place in places):
        yield Key("ring", INK, "alike wherever the robot drives")
    if has_landmarks:
        yield Key("diamond", LANDMARK, "landmark")


def _colour(place: Place) -> str:
    return next(colour for most, colour in COLOURS if len(place.look_alikes) <= most)


def _draw_place(draw: ImageDraw.ImageDraw, view: View, place: Place) -> None:
    colour, alpha = _colour(place), "70" if len(place.look_alikes) < _MANY else "28"
    start = view.at(*place.pose[:2])
    for other in place.look_alikes:
        draw.line((start, view.at(*other[:2])), fill=f"{colour}{alpha}", width=_LINE_PX)
        draw.polygon(_arrow(view, other), outline=colour, width=_LINE_PX)
    draw.polygon(_arrow(view, place.pose), fill=colour)
    if place.distinguishable is False:
        draw.circle(start, 1.5 * _ARROW_PX, outline=colour, width=_LINE_PX)


def _arrow(view: View, pose: PoseTuple) -> list[tuple[float, float]]:
    corners = np.array([(1.6, 0.0, 0.0), (-1.0, 0.9, 0.0), (-1.0, -0.9, 0.0)])
    corners *= _ARROW_PX / view.px_per_m
    return [view.at(x, y) for x, y, _ in compose(np.array(pose), corners)]
