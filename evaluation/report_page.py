"""Reports as one self-contained HTML file: the frame of all reports, and `evaluate --report`."""

import base64
import html
import io
import itertools
import math
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version

import numpy as np
from PIL import Image

from evaluation.measures import StepFacts
from grid_maps.grid_map import GridMap
from grid_maps.map_message import to_message
from live_view.drawing import PALETTE, map_picture
from live_view.map_reduction import reduced
from particle_filter.arrays import FREE, Poses
from particle_filter.poses import compose

DRAWN_RUNS = 12
"""Most runs drawn; the table has all."""
_WIDTH, _HEIGHT, _LEFT, _BELOW = 560.0, 150.0, 54.0, 18.0
"""Size of a plot, and its left and lower margins [px]."""
_MOST_ERROR_M = 10.0
_JUMP_M = 2.0
_MOST_PLACES = 12
_MARGIN_M = 0.5
_TRUE, _RIGHT, _WRONG = "#1a2027", PALETTE[1], "#c0262d"
_STYLE = """
:root {
  color-scheme: light dark; --ink: #1a2027; --soft: #5c6875; --line: #dfe3e8; --ground: #fff;
}
@media (prefers-color-scheme: dark) {
  :root { --ink: #e8edf3; --soft: #96a3b2; --line: #2a333e; --ground: #10141a; }
  .map { filter: brightness(.85); }
}
body {
  margin: 28px auto; max-width: 1240px; padding: 0 18px; background: var(--ground);
  color: var(--ink); font: 14px/1.5 system-ui, sans-serif; font-variant-numeric: tabular-nums;
}
.run {
  display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 18px;
  align-items: start; border-top: 1px solid var(--line); padding: 14px 0;
}
.run h2 { grid-column: 1 / -1; margin: 0; font-size: 16px; }
svg { width: 100%; height: auto; max-height: 600px; }
.legend, figcaption { color: var(--soft); }
figure { margin: 0 0 12px; }
text { fill: var(--soft); font-size: 11px; }
table { border-collapse: collapse; overflow-x: auto; display: block; margin-bottom: 14px; }
th, td { text-align: right; padding: 3px 9px; white-space: nowrap; }
th, td { border-bottom: 1px solid var(--line); }
i { font-style: normal; font-weight: 600; white-space: nowrap; color: var(--ink); }
i::before {
  content: ""; display: inline-block; width: 18px; height: 3px; margin-right: 5px;
  vertical-align: middle; background: var(--of);
}
code { overflow-wrap: anywhere; }
pre { overflow-x: auto; }
@media (max-width: 800px) {
  .run { grid-template-columns: 1fr; }
  th, td { padding: 3px 4px; font-size: 13px; }
}
"""

_Curve = tuple[Sequence[tuple[int, float]], str]
"""Points (step, value) and a colour."""


@dataclass(frozen=True)
class TableText:
    """A table as text: the names of the columns, and the rows."""

    names: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class DrawnRun:
    """A run to draw: its seed and steps."""

    seed: int
    steps: Sequence[StepFacts]


def report_page(
    title: str,
    grid_map: GridMap,
    drawn_runs: Sequence[DrawnRun],
    tables: Sequence[TableText],
) -> str:
    """Return the page of evaluated runs.

    Args:
        title: the experiment and its result.
        grid_map: the map of all runs.
        drawn_runs: runs to draw; steps without a known true pose are left out.
        tables: tables of all runs.
    """
    drawn = MapDrawing(grid_map)
    runs = "".join(_run(run, drawn) for run in drawn_runs if any(s.truth for s in run.steps))
    legend = (
        f'On the map: <i style="--of:{_RIGHT}">the estimate, right</i>, '
        f'<i style="--of:{_WRONG}">wrong</i> (beyond 1 m or 20 degrees), and the true path, '
        f"dotted. The first {DRAWN_RUNS} runs are drawn, where the true pose is known."
    )
    return html_page(title, "".join(map(_table, tables)), legend, drawn.shared + runs)


def html_page(title: str, before: str, legend: str, after: str) -> str:
    """Return a page with its date, version and command.

    Args:
        title: plain text.
        before: HTML above the legend.
        legend: HTML of a paragraph.
        after: HTML below it.
    """
    shown = html.escape(title)
    command = html.escape(shlex.join(["clustermcl", *sys.argv[1:]]))
    origin = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, version {version('clustermcl')}"
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{shown}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_STYLE}</style></head><body>\n<h1>{shown}</h1>\n"
        f'<p class="legend">{origin}: <code>{command}</code></p>\n{before}\n'
        f'<p class="legend">{legend}</p>\n{after}</body></html>\n'
    )


class MapDrawing:
    """Draws on a map, cropped to its free ground; coordinates in metres, `map_from_...`."""

    def __init__(self, grid_map: GridMap) -> None:
        self._map = reduced(to_message(grid_map, "report"))
        self.west, self.south, self.east, self.north = free_bounds(grid_map)

    @property
    def size_m(self) -> float:
        """Length of the longer side."""
        return max(self.east - self.west, self.north - self.south)

    @property
    def shared(self) -> str:
        """SVG of the map, which has to be in the page once, above the drawings."""
        pixels = png_data(map_picture(self._map))
        x, y, heading = self._map.map_from_grid
        c, s = math.cos(heading), math.sin(heading)
        width, height = self._map.cols * self._map.cell_m, self._map.rows * self._map.cell_m
        return (
            '<svg width="0" height="0" style="position:absolute"><defs><g id="map"><image '
            f'transform="matrix({c:.6f} {s:.6f} {-s:.6f} {c:.6f} {x:.3f} {y:.3f})" '
            f'width="{width:.3f}" height="{height:.3f}" preserveAspectRatio="none" '
            f'style="image-rendering:pixelated" href="{pixels}"/></g></defs></svg>\n'
        )

    def with_shapes(self, shapes: Sequence[str]) -> str:
        """Return SVG of the map with shapes over it."""
        box = (
            f"{self.west:.2f} {-self.north:.2f} "
            f"{self.east - self.west:.2f} {self.north - self.south:.2f}"
        )
        return (
            f'<svg class="map" viewBox="{box}"><g transform="scale(1 -1)"><use href="#map"/>'
            f"{''.join(shapes)}</g></svg>"
        )


def png_data(picture: Image.Image) -> str:
    """Return a picture as a ``data:`` address."""
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


def _run(run: DrawnRun, drawn: MapDrawing) -> str:
    steps = [step for step in run.steps if step.truth]
    last = steps[-1].step
    errors = [
        (each.step, min(each.error.distance_m, _MOST_ERROR_M)) for each in steps if each.error
    ]
    of_truth = [(step.step, step.truth_probability if step.claims else 0.0) for step in steps]
    most_m = max((error for _, error in errors), default=0.0)
    scale_m = next((m for m in (0.2, 0.5, 1.0, 2.0, 5.0) if most_m <= m), _MOST_ERROR_M)
    return (
        f'<section class="run"><h2>seed {run.seed}</h2>'
        f"<figure>{_map(steps, drawn)}</figure><div>"
        f"<figure>{_plot([(errors, _WRONG)], last, scale_m, ' m')}<figcaption>how far the most "
        f"probable place is off, up to {_MOST_ERROR_M:.0f} m</figcaption></figure>"
        f"<figure>{_plot([*_of_clusters(steps), (of_truth, _TRUE)], last, 1.0)}<figcaption>"
        "probability of each place, and of all that are right (the thick line)"
        "</figcaption></figure></div></section>\n"
    )


def _of_clusters(steps: Sequence[StepFacts]) -> list[_Curve]:
    curves: dict[int, list[tuple[int, float]]] = {}
    for step in steps:
        for place in step.claims[:_MOST_PLACES]:
            curves.setdefault(place.cluster, []).append((step.step, place.probability))
    return [(curve, PALETTE[i % len(PALETTE)]) for i, curve in enumerate(curves.values())]


def _map(steps: Sequence[StepFacts], drawn: MapDrawing) -> str:
    stroke_m = drawn.size_m / 250.0
    truth = _ways([step.truth[:2] for step in steps if step.truth], _TRUE, stroke_m, dotted=True)
    estimates = [
        way
        for kind, group in itertools.groupby(steps, lambda step: (bool(step.claims), step.right))
        if kind[0]
        for way in _ways(
            [(step.claims[0].x_m, step.claims[0].y_m) for step in group],
            _RIGHT if kind[1] else _WRONG,
            stroke_m,
        )
    ]
    return drawn.with_shapes([*estimates, *truth])


def _ways(
    points: Sequence[tuple[float, ...]], colour: str, stroke_m: float, *, dotted: bool = False
) -> list[str]:
    """Return lines through places, interrupted at jumps."""
    parts: list[list[tuple[float, ...]]] = []
    for point in points:
        if not parts or math.dist(parts[-1][-1], point) > _JUMP_M:
            parts.append([])
        parts[-1].append(point)
    dots = f' stroke-dasharray="0 {2.5 * stroke_m:.3f}"' if dotted else ""
    return [
        f'<polyline points="{" ".join(f"{x:.2f},{y:.2f}" for x, y in (*part, part[-1]))}" '
        f'fill="none" stroke="{colour}" stroke-width="{stroke_m:.3f}" stroke-linecap="round"'
        f"{dots}/>"
        for part in parts
    ]


def _plot(curves: Sequence[_Curve], last: int, most: float, unit: str = "") -> str:
    def place(step: int, value: float) -> tuple[float, float]:
        across = (step / max(last, 1)) * (_WIDTH - _LEFT - 6.0)
        return _LEFT + across, (1.0 - value / most) * (_HEIGHT - _BELOW - 8.0) + 8.0

    grid = [
        f'<line x1="{_LEFT}" x2="{_WIDTH}" y1="{y:.1f}" y2="{y:.1f}" stroke="currentColor" '
        f'opacity=".15"/><text x="{_LEFT - 5}" y="{y + 4:.1f}" text-anchor="end">{value:g}{unit}'
        "</text>"
        for value in (0.0, most / 2.0, most)
        for _, y in [place(0, value)]
    ]
    drawn = [
        f'<polyline fill="none" stroke-width="{3.0 if colour == _TRUE else 1.6}" '
        f'stroke="{"currentColor" if colour == _TRUE else colour}" '
        f'points="{" ".join("{:.1f},{:.1f}".format(*place(*point)) for point in curve)}"/>'
        for curve, colour in curves
    ]
    end = f'<text x="{_WIDTH - 2}" y="{_HEIGHT - 3}" text-anchor="end">step {last}</text>'
    return f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}">{"".join([*grid, *drawn])}{end}</svg>'


def _table(table: TableText) -> str:
    head = "".join(f"<th>{html.escape(name)}</th>" for name in table.names)
    rows = "".join(
        f"<tr>{''.join(f'<td>{html.escape(cell)}</td>' for cell in row)}</tr>" for row in table.rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
