"""Draws maps, places and runs with matplotlib, the extra `plots`; axes are in metres."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from clustermcl.filter.arrays import FREE, OCCUPIED
from clustermcl.filter.poses import compose
from clustermcl.protocol.answers import Hypothesis
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.errors import ClusterMclError
from clustermcl.protocol.message import PoseTuple, ellipse_axes
from clustermcl.protocol.steps import Scan
from clustermcl.recordings.maps.grid_map import GridMap, coarse
from clustermcl.view.frames import MAX_SIDE, scan_points_cm

PALETTE = (
    "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#8C6BB1", "#9A8B4F",
)  # fmt: skip
"""Colours of places, the same as in `palette.js`."""
CHANGES = {"gone": "#c0262d", "new": "#0072B2", "moving": "#E69F00"}
"""Colours of changes by their kind, the same as in `changes.js`."""
INK, SCAN = "#1a2027", "#c0262d"
_FREE_RGB, _OCCUPIED_RGB, _UNKNOWN_RGB = (255, 255, 255), (42, 50, 59), (227, 230, 234)
_SIGMAS = 2.0
_LABELLED = 8
_SIDE_INCHES, _DPI = 10.0, 150


class NoExtraError(ClusterMclError, ImportError):
    """A library that a command needs is not installed."""

    def __init__(self, extra: str, error: ImportError) -> None:
        super().__init__(f"it needs an extra: pip install 'clustermcl[{extra}]' ({error})")


class Drawn(NamedTuple):
    """A step of a run, as `draw_run` shows it."""

    stamp_ns: int
    pose: PoseTuple
    probability: float
    error_m: float | None
    """Distance from the true position; None if that is unknown."""


def new_figure(heights: Sequence[float] = (1.0,)) -> Any:
    """Return a figure of matplotlib with axes of these heights; raises `NoExtraError`."""
    try:
        from matplotlib.figure import Figure  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise NoExtraError("plots", error) from error
    figure = Figure(figsize=(_SIDE_INCHES, _SIDE_INCHES), layout="constrained")
    figure.subplots(len(heights), height_ratios=heights)
    return figure


def save(figure: Any, file: Path) -> None:
    """Write a figure as a PNG file."""
    figure.savefig(file, dpi=_DPI, format="png")


def draw_map(axes: Any, grid_map: GridMap) -> None:
    """Draw the cells; of a very large map, one for several."""
    from matplotlib.transforms import Affine2D  # noqa: PLC0415 - an extra

    every = -(-max(grid_map.cells.shape) // MAX_SIDE)
    cells = coarse(grid_map.cells, every)
    colours = np.full((*cells.shape, 3), _UNKNOWN_RGB, np.uint8)
    colours[cells == FREE], colours[cells == OCCUPIED] = _FREE_RGB, _OCCUPIED_RGB
    width, height = (every * grid_map.cell_m * count for count in cells.shape[::-1])
    x, y, heading = grid_map.map_from_grid
    from_grid = Affine2D().rotate(heading).translate(x, y) + axes.transData
    extent = (0.0, width, 0.0, height)
    axes.imshow(colours, origin="lower", extent=extent, transform=from_grid, interpolation="none")
    corners = compose(
        np.array((x, y, heading)), np.array([(a, b, 0.0) for a in (0, width) for b in (0, height)])
    )
    low, high = corners.min(axis=0), corners.max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
    axes.set(aspect="equal", facecolor=np.array(_UNKNOWN_RGB) / 255)


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
    for kind, (name, colour) in enumerate(CHANGES.items()):
        if (kinds == kind).any():
            x, y = centres[kinds == kind].T
            axes.plot(x, y, "s", color=colour, markersize=2, label=name)


def draw_places(
    axes: Any,
    places: Sequence[Hypothesis],
    scan: Scan | None = None,
    truth: PoseTuple | None = None,
) -> None:
    """Draw each place by its probability, and the scan as from the first, the most probable."""
    from matplotlib.patches import Ellipse  # noqa: PLC0415 - an extra

    if places and scan is not None and (points := scan_points_cm(scan)):
        ends = np.column_stack([np.reshape(points, (-1, 2)) / 100.0, np.zeros(len(points) // 2)])
        x, y, _ = compose(np.array(places[0].pose), ends).T
        axes.plot(x, y, ".", color=SCAN, markersize=3, label="scan, as from the most probable")
    if truth is not None:
        axes.plot(*truth[:2], "o", mfc="none", mec=INK, mew=2, markersize=22, label="true pose")
    for rank, place in reversed(list(enumerate(places))):
        colour, (x, y, _) = PALETTE[place.cluster % len(PALETTE)], place.pose
        c = place.covariance
        long_m, short_m, along = ellipse_axes(c[0], c[1], c[4])
        size = (2 * _SIGMAS * long_m, 2 * _SIGMAS * short_m)
        axes.add_patch(
            Ellipse((x, y), *size, angle=math.degrees(along), color=colour, alpha=0.25, lw=0)
        )
        draw_arrows(axes, [place.pose], 40.0 + 160.0 * place.probability, color=colour)
        if rank < _LABELLED:
            axes.annotate(
                percent(place.probability), (x, y), (0, 12), textcoords="offset points",
                ha="center", color=INK, bbox={"color": "white", "alpha": 0.8, "pad": 1},
            )  # fmt: skip


def draw_run(figure: Any, grid_map: GridMap, steps: Sequence[Drawn]) -> None:
    """Draw the path coloured by probability on the map, and probability and error over time."""
    above, below = figure.axes
    draw_map(above, grid_map)
    x, y, _ = np.array([step.pose for step in steps]).T
    shares = [step.probability for step in steps]
    path = above.scatter(x, y, 12, shares, cmap="viridis", vmin=0.0, vmax=1.0)
    figure.colorbar(path, ax=above, label="probability of the estimate")
    times = [(step.stamp_ns - steps[0].stamp_ns) / 1e9 for step in steps]
    below.plot(times, shares, color=PALETTE[1])
    below.set(xlabel="time [s]", ylabel="probability of the estimate", ylim=(-0.02, 1.02))
    if any(step.error_m is not None for step in steps):
        errors = below.twinx()
        errors.plot(times, [step.error_m for step in steps], color=SCAN)
        errors.set_yscale("symlog", linthresh=0.1)
        errors.set_ylabel("position error [m]", color=SCAN)


def draw_arrows(axes: Any, poses: Sequence[PoseTuple], size: float, **how: Any) -> None:
    """Draw poses as triangles that point along the heading."""
    for x, y, heading in poses:
        axes.scatter(x, y, size, marker=(3, 0, math.degrees(heading) - 90.0), **how)


def percent(probability: float) -> str:
    """Format a probability as percent, like `palette.js`; below 0.001 as ``< 0.1 %``."""
    if probability >= 0.9995:
        return "100 %"
    if probability < 0.001:
        return "< 0.1 %"
    return f"{100 * probability:.{1 if probability < 0.0995 else 0}f} %"
