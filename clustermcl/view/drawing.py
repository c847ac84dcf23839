"""Draws a picture of the map and the places where the robot may be."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from clustermcl.filter.arrays import FREE, OCCUPIED
from clustermcl.filter.poses import compose
from clustermcl.protocol.message import ellipse_axes
from clustermcl.recordings.maps.grid_map import GridMap, coarse
from clustermcl.view.caption import INK, Key, captioned
from clustermcl.view.map_reduction import MAX_SIDE

PALETTE = (
    "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8C6BB1", "#9A8B4F",
)  # fmt: skip
"""Colours of places by slot, the same as in `palette.js`."""
_FREE_RGB, _OCCUPIED_RGB, _UNKNOWN_RGB = (255, 255, 255), (42, 50, 59), (227, 230, 234)
_SCAN = "#c0262d"
LONG_SIDE_PX = 1400
"""Long side of the map in the picture, without margins."""
_MARGIN_PX = 24
_FINER = 2
"""Factor by which the drawing is larger than the picture, for smooth edges."""
_SIGMAS = 2.0
_LABELLED = 8
_LEGEND = (
    Key("disc", PALETTE[0], "possible place: probability, heading, ellipse of 2 sigma"),
    Key("disc", _SCAN, "scan, as seen from the most probable place"),
)


class View(NamedTuple):
    """Conversion from the map to pixels of the drawing."""

    left_m: float
    top_m: float
    px_per_m: float

    def at(self, x_m: float, y_m: float) -> tuple[float, float]:
        return (x_m - self.left_m) * self.px_per_m, (self.top_m - y_m) * self.px_per_m


def drawn_picture(grid_map: GridMap, step: Mapping[str, Any], title: str = "") -> Image.Image:
    """Draw the whole map, and the places, the scan and the true pose of a step (see `step_frame`).

    A drawn cell of a very large map stands for several. With a title, the picture has the date, a
    scale bar and a legend too.
    """
    canvas, view = map_canvas(grid_map)
    draw = ImageDraw.Draw(canvas, "RGBA")
    places = step["places"]
    if places:
        _draw_scan(draw, view, places[0]["pose"], step["scan"])
    if step["truth"] is not None:
        _draw_truth(draw, view, step["truth"])
    for index, place in reversed(list(enumerate(places))):
        _draw_place(draw, view, place, labelled=index < _LABELLED)
    return smoothed(captioned(canvas, view.px_per_m, title, _LEGEND) if title else canvas)


def map_canvas(grid_map: GridMap) -> tuple[Image.Image, View]:
    """Return a drawing of the map, to be drawn on and then smoothed by `smoothed`."""
    view, size = _view_of(grid_map)
    canvas = Image.new("RGB", size, _UNKNOWN_RGB)
    _paste_map(canvas, grid_map, view)
    return canvas, view


def smoothed(canvas: Image.Image) -> Image.Image:
    size = (canvas.width // _FINER, canvas.height // _FINER)
    return canvas.resize(size, Image.Resampling.LANCZOS)


def extent_m(grid_map: GridMap) -> tuple[float, float, float, float]:
    """Return the left, right, lower and upper edge of a map's picture [m]."""
    view, (width, height) = _view_of(grid_map)
    right_m = view.left_m + width / view.px_per_m
    return view.left_m, right_m, view.top_m - height / view.px_per_m, view.top_m


def _view_of(grid_map: GridMap) -> tuple[View, tuple[int, int]]:
    x0, y0, heading = grid_map.map_from_grid
    c, s = math.cos(heading), math.sin(heading)
    width, height = grid_map.size_m
    corners = ((0.0, 0.0), (width, 0.0), (width, height), (0.0, height))
    xs, ys = zip(*((x0 + c * a - s * b, y0 + s * a + c * b) for a, b in corners), strict=True)
    long_m = max(max(xs) - min(xs), max(ys) - min(ys))
    px_per_m = _FINER * LONG_SIDE_PX / long_m
    margin = _FINER * _MARGIN_PX
    view = View(min(xs) - margin / px_per_m, max(ys) + margin / px_per_m, px_per_m)
    right, bottom = view.at(max(xs), min(ys))
    return view, (math.ceil(right + margin), math.ceil(bottom + margin))


def _paste_map(canvas: Image.Image, grid_map: GridMap, view: View) -> None:
    """Draw the cells, rotated by the heading of the grid in the map."""
    x0, y0, heading = grid_map.map_from_grid
    c, s = math.cos(heading), math.sin(heading)
    every = -(-max(grid_map.cells.shape) // MAX_SIDE)
    k, cell = 1.0 / view.px_per_m, 1.0 / (every * grid_map.cell_m)
    # From a pixel (u, v) to the map frame, and from there to its cell.
    dx, dy = view.left_m - x0, view.top_m - y0
    coefficients = (
        c * k * cell, -s * k * cell, (c * dx + s * dy) * cell,
        -s * k * cell, -c * k * cell, (-s * dx + c * dy) * cell,
    )  # fmt: skip
    cells = coarse(grid_map.cells, every)
    colours = np.full((*cells.shape, 3), _UNKNOWN_RGB, np.uint8)  # a pixel for each cell
    colours[cells == FREE], colours[cells == OCCUPIED] = _FREE_RGB, _OCCUPIED_RGB
    turned = Image.fromarray(colours).transform(
        canvas.size, Image.Transform.AFFINE, coefficients, fillcolor=_UNKNOWN_RGB
    )
    canvas.paste(turned)


def _draw_scan(
    draw: ImageDraw.ImageDraw, view: View, pose: tuple[float, float, float], points_cm: list[int]
) -> None:
    x, y, heading = pose
    c, s = math.cos(heading) / 100.0, math.sin(heading) / 100.0
    for ahead, aside in zip(points_cm[::2], points_cm[1::2], strict=True):
        left, top = view.at(x + c * ahead - s * aside, y + s * ahead + c * aside)
        draw.ellipse((left - 4, top - 4, left + 4, top + 4), fill=_SCAN)


def _draw_truth(draw: ImageDraw.ImageDraw, view: View, pose: tuple[float, float, float]) -> None:
    x, y = view.at(pose[0], pose[1])
    radius = 38
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=INK, width=5)
    c, s = math.cos(pose[2]), -math.sin(pose[2])
    draw.line((x + radius * c, y + radius * s, x + 60 * c, y + 60 * s), fill=INK, width=5)


def _draw_place(
    draw: ImageDraw.ImageDraw, view: View, place: Mapping[str, Any], *, labelled: bool
) -> None:
    colour = PALETTE[place["slot"] % len(PALETTE)]
    x_m, y_m, heading = place["pose"]
    draw.polygon(_ellipse(view, place), fill=f"{colour}40", outline=colour, width=3)
    x, y = view.at(x_m, y_m)
    radius = _FINER * (6 + 8 * math.sqrt(place["p"]))
    nose = [
        (
            x + scale * radius * math.cos(heading + turn),
            y - scale * radius * math.sin(heading + turn),
        )
        for scale, turn in ((1.0, 0.6), (1.9, 0.0), (1.0, -0.6))
    ]
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
    draw.polygon(nose, fill=colour)
    if labelled:
        text, font = percent(place["p"]), ImageFont.load_default(size=24)
        draw.text((x, y - radius - 24), text, fill=INK, font=font, anchor="mm", stroke_width=5,
                  stroke_fill="white")  # fmt: skip


def percent(probability: float) -> str:
    """Format a probability as percent, like `palette.js`; below 0.001 as ``< 0.1 %``."""
    if probability >= 0.9995:
        return "100 %"
    if probability < 0.001:
        return "< 0.1 %"
    return f"{100 * probability:.{1 if probability < 0.0995 else 0}f} %"


def _ellipse(view: View, place: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Return the ellipse of two standard deviations of the position as a polygon [px]."""
    x_m, y_m, _ = place["pose"]
    long_m, short_m, along = ellipse_axes(*place["cov"][:3])
    around = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    circle = np.column_stack([long_m * np.cos(around), short_m * np.sin(around), around])
    points = compose(np.array((x_m, y_m, along)), _SIGMAS * circle)
    return [view.at(x, y) for x, y, _ in points]
