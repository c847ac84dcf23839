"""`clustermcl check --report`: the map with its look-alike places, drawn on a page."""

import base64
import html
import io
import math
import shlex
import sys
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from evaluation.map_check.report import MapReport
from grid_maps.grid_map import GridMap
from grid_maps.map_message import to_message
from live_view.drawing import map_picture
from live_view.map_reduction import reduced
from particle_filter.arrays import FREE, Poses
from particle_filter.poses import compose
from particle_filter.sensor_model import ground_log_penalty
from protocol.message import PoseTuple

_MARGIN_M = 0.5
_STYLE = """
:root { color-scheme: light dark; --ink: #1a2027; --soft: #5c6875; --ground: #fff; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8edf3; --soft: #96a3b2; --ground: #10141a; }
  .map { filter: brightness(.85); }
}
body {
  margin: 28px auto; max-width: 1240px; padding: 0 18px; background: var(--ground);
  color: var(--ink); font: 14px/1.5 system-ui, sans-serif; font-variant-numeric: tabular-nums;
}
svg { width: 100%; height: auto; max-height: 600px; }
.legend { color: var(--soft); }
figure { margin: 0 0 12px; }
i { font-style: normal; font-weight: 600; white-space: nowrap; color: var(--ink); }
i::before {
  content: ""; display: inline-block; width: 18px; height: 3px; margin-right: 5px;
  vertical-align: middle; background: var(--of);
}
code { overflow-wrap: anywhere; }
pre { overflow-x: auto; }
"""

_UNIQUE, _ALIKE, _SYMMETRY = "#0072B2", "#D55E00", "#7d3cb5"
_HEAT = ((1, "#009E73"), (2, "#F0E442"), (4, "#E69F00"), (10**9, "#c0262d"))
"""The colour by the largest number of places that look alike, counting the tested place."""
_HEAT_CELLS, _HEAT_ALPHA = 300, 90
"""Cells along the longer side of the image, and its opacity, of 255."""
_HEAT_SPACINGS = 1.5
"""Radius that a place colours, in mean distances between the places."""


def map_page(report: MapReport, lines: Sequence[str], grid_map: GridMap) -> str:
    """Return the page of a checked map.

    Args:
        report: results of the check.
        lines: the results as text.
        grid_map: the map.
    """
    drawn = MapDrawing(grid_map)
    one, few, some, many = (f'<i style="--of:{colour}">' for _, colour in _HEAT)
    legend = (
        "Where a robot will be ambiguous, by the number of places that look like the nearest "
        f"tested one: {one}none</i>, {few}one</i>, {some}two or three</i>, {many}more</i>. "
        f'Tested places: <i style="--of:{_UNIQUE}">unique</i>, '
        f'<i style="--of:{_ALIKE}">joined with its look-alikes</i>; '
        f'<i style="--of:{_SYMMETRY}">symmetries</i>: a ring about which the map looks the same '
        "when turned, a line along which it looks the same when shifted."
    )
    shapes = [_heat(report, grid_map, drawn), *_symmetries(report, drawn), *_places(report, drawn)]
    unique = sum(not place.look_alikes for place in report.places)
    title = html.escape(
        f"{Path(report.map).name}: {unique} of {len(report.places)} places are unique"
    )
    command = html.escape(shlex.join(["clustermcl", *sys.argv[1:]]))
    origin = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, version {version('clustermcl')}"
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_STYLE}</style></head><body>\n<h1>{title}</h1>\n"
        f'<p class="legend">{origin}: <code>{command}</code></p>\n'
        f'<p class="legend">{legend}</p>\n<figure>{drawn.with_shapes(shapes)}</figure>'
        f"<pre>{html.escape(chr(10).join(lines))}</pre></body></html>\n"
    )


class MapDrawing:
    """Draws on a map, cropped to its free ground; coordinates are metres in the map frame."""

    def __init__(self, grid_map: GridMap) -> None:
        self._map = reduced(to_message(grid_map, "report"))
        self.west, self.south, self.east, self.north = free_bounds(grid_map)

    @property
    def size_m(self) -> float:
        """Length of the longer side."""
        return max(self.east - self.west, self.north - self.south)

    def with_shapes(self, shapes: Sequence[str]) -> str:
        """Return SVG of the map with shapes over it."""
        box = (
            f"{self.west:.2f} {-self.north:.2f} "
            f"{self.east - self.west:.2f} {self.north - self.south:.2f}"
        )
        pixels = png_data(map_picture(self._map))
        x, y, heading = self._map.map_from_grid
        c, s = math.cos(heading), math.sin(heading)
        width, height = self._map.cols * self._map.cell_m, self._map.rows * self._map.cell_m
        return (
            f'<svg class="map" viewBox="{box}"><g transform="scale(1 -1)"><image '
            f'transform="matrix({c:.6f} {s:.6f} {-s:.6f} {c:.6f} {x:.3f} {y:.3f})" '
            f'width="{width:.3f}" height="{height:.3f}" preserveAspectRatio="none" '
            f'style="image-rendering:pixelated" href="{pixels}"/>{"".join(shapes)}</g></svg>'
        )


def png_data(picture: Image.Image) -> str:
    pixels = io.BytesIO()
    picture.save(pixels, "PNG", optimize=True)
    return f"data:image/png;base64,{base64.b64encode(pixels.getvalue()).decode()}"


def free_bounds(grid_map: GridMap) -> tuple[float, float, float, float]:
    """Return the west, south, east and north edge of the free ground [m], with a margin."""
    rows, cols = np.nonzero(grid_map.cells == FREE)
    sides = [(float(each.min()), float(each.max()) + 1.0) for each in (cols, rows)]
    corners: Poses = np.array([(col, row, 0.0) for col in sides[0] for row in sides[1]])
    corners[:, :2] *= grid_map.cell_m
    xy = compose(np.array(grid_map.map_from_grid), corners)[:, :2]
    (west, south), (east, north) = xy.min(axis=0) - _MARGIN_M, xy.max(axis=0) + _MARGIN_M
    return float(west), float(south), float(east), float(north)


def _places(report: MapReport, drawn: MapDrawing) -> Iterator[str]:
    size_m = drawn.size_m / 130.0
    for place in sorted(report.places, key=lambda place: len(place.look_alikes)):
        colour = _ALIKE if place.look_alikes else _UNIQUE
        x, y, _ = place.map_from_robot
        opacity = 0.45 if len(place.look_alikes) < 8 else 0.15
        for other in place.look_alikes:
            yield (
                f'<line x1="{x:.2f}" y1="{y:.2f}" x2="{other[0]:.2f}" y2="{other[1]:.2f}" '
                f'stroke="{colour}" stroke-width="{size_m / 4:.3f}" opacity="{opacity}"/>'
            )
            yield _arrow(other, colour, size_m, "none")
        yield _arrow(place.map_from_robot, colour, size_m, colour)


def _arrow(pose: PoseTuple, colour: str, size_m: float, fill: str) -> str:
    corners = np.array([(1.6, 0.0, 0.0), (-1.0, 0.9, 0.0), (-1.0, -0.9, 0.0)]) * size_m
    points = " ".join(f"{x:.3f},{y:.3f}" for x, y, _ in compose(np.array(pose), corners))
    return (
        f'<polygon points="{points}" fill="{fill}" stroke="{colour}" '
        f'stroke-width="{size_m / 4:.3f}" stroke-linejoin="round"/>'
    )


def _symmetries(report: MapReport, drawn: MapDrawing) -> Iterator[str]:
    stroke_m = drawn.size_m / 250.0
    style = f'fill="none" stroke="{_SYMMETRY}" stroke-width="{stroke_m:.3f}"'
    middle = (drawn.west + drawn.east) / 2.0, (drawn.south + drawn.north) / 2.0
    for symmetry in report.symmetries:
        if symmetry.about_m is not None:
            x, y = symmetry.about_m
            yield f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{6 * stroke_m:.3f}" {style}/>'
        elif symmetry.shift_m is not None:
            (x, y), (dx, dy) = middle, symmetry.shift_m
            yield (
                f'<line x1="{x - dx / 2:.2f}" y1="{y - dy / 2:.2f}" x2="{x + dx / 2:.2f}" '
                f'y2="{y + dy / 2:.2f}" {style}/>'
            )


def _heat(report: MapReport, grid_map: GridMap, drawn: MapDrawing) -> str:
    """Return SVG of an image with free ground coloured by the number of look-alikes."""
    groups = [(place.map_from_robot, *place.look_alikes) for place in report.places]
    known = np.array([pose[:2] for group in groups for pose in group])
    alike = np.array([len(group) for group in groups for _ in group])
    cell_m = drawn.size_m / _HEAT_CELLS
    east = np.arange(drawn.west + cell_m / 2, drawn.east, cell_m)
    south = np.arange(drawn.north - cell_m / 2, drawn.south, -cell_m)
    x, y = (axis.ravel() for axis in np.meshgrid(east, south))
    reach_m = _HEAT_SPACINGS * np.sqrt(grid_map.free_area_m2 / len(known))
    distance_m, nearest = cKDTree(known).query(np.column_stack([x, y]))
    poses = np.column_stack([x, y, np.zeros_like(x)])
    is_free = ground_log_penalty(poses, grid_map.grid, -1.0) == 0.0
    inside = (distance_m < reach_m) & is_free
    pixels = np.zeros((len(south), len(east), 4), np.uint8)
    of_number = np.searchsorted([most for most, _ in _HEAT], alike)
    colours = np.array([[*bytes.fromhex(colour[1:]), _HEAT_ALPHA] for _, colour in _HEAT], np.uint8)
    pixels.reshape(-1, 4)[inside] = colours[of_number[np.asarray(nearest)[inside]]]
    width_m, height_m = len(east) * cell_m, len(south) * cell_m
    return (
        f'<image transform="matrix(1 0 0 -1 {drawn.west:.3f} {drawn.north:.3f})" '
        f'width="{width_m:.3f}" height="{height_m:.3f}" preserveAspectRatio="none" '
        f'href="{png_data(Image.fromarray(pixels))}"/>'
    )
