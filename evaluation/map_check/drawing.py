"""`clustermcl check --report`: the map with its look-alike places, drawn on a page."""

import html
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from evaluation.map_check.report import MapReport
from evaluation.report_page import MapDrawing, html_page, png_data
from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE
from particle_filter.poses import compose, inverse
from protocol.message import PoseTuple

_UNIQUE, _ALIKE, _SYMMETRY = "#0072B2", "#D55E00", "#7d3cb5"
_HEAT = ((1, "#009E73"), (2, "#F0E442"), (4, "#E69F00"), (10**9, "#c0262d"))
"""Up to this number of places that look alike: the colour."""
_HEAT_CELLS, _HEAT_ALPHA = 300, 90
"""Cells along the longer side, and opacity of 255."""
_HEAT_SPACINGS = 1.5
"""A tested place colours the ground around it, by this many mean distances of tested places."""


def map_page(report: MapReport, lines: Sequence[str], grid_map: GridMap) -> str:
    """Return the page of a checked map.

    Args:
        report: results of the check.
        lines: the results as text.
        grid_map: the map.
    """
    drawn = MapDrawing(grid_map)
    words = f"<pre>{html.escape(chr(10).join(lines))}</pre>"
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
    figure = f"<figure>{drawn.with_shapes(shapes)}</figure>"
    unique = sum(not place.look_alikes for place in report.places)
    title = f"{Path(report.map).name}: {unique} of {len(report.places)} places are unique"
    return html_page(title, "", legend, drawn.shared + figure + words)


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
    """Return an image as SVG that colours free ground by its number of look-alikes."""
    groups = [(place.map_from_robot, *place.look_alikes) for place in report.places]
    known = np.array([pose[:2] for group in groups for pose in group])
    alike = np.array([len(group) for group in groups for _ in group])
    cell_m = drawn.size_m / _HEAT_CELLS
    east = np.arange(drawn.west + cell_m / 2, drawn.east, cell_m)
    south = np.arange(drawn.north - cell_m / 2, drawn.south, -cell_m)
    x, y = (axis.ravel() for axis in np.meshgrid(east, south))
    reach_m = _HEAT_SPACINGS * np.sqrt(grid_map.free_area_m2 / len(known))
    distance_m, nearest = cKDTree(known).query(np.column_stack([x, y]))
    inside = (distance_m < reach_m) & _is_free(grid_map, x, y)
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


def _is_free(grid_map: GridMap, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return whether points in the map frame [m] lie in free cells, (N,)."""
    poses = np.column_stack([x, y, np.zeros_like(x)])
    in_grid = compose(inverse(np.array(grid_map.map_from_grid)), poses)
    rows, cols = grid_map.cells.shape
    col, row = (np.floor(in_grid[:, axis] / grid_map.cell_m).astype(int) for axis in (0, 1))
    inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
    free = np.zeros(len(x), bool)
    free[inside] = grid_map.cells[row[inside], col[inside]] == FREE
    return free
