"""Plots of experiments; matplotlib is an extra, and without it everything else is written."""

import importlib.util
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from evaluation.experiments.case import NAMES, Algorithm
from evaluation.experiments.reliability import Reliability
from evaluation.experiments.trace import Trace
from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, OCCUPIED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MISSING = "matplotlib is not installed, so no plots are drawn; pip install 'clustermcl[plots]'"

_RIGHT, _WRONG, _OTHER, _TRUTH = "tab:green", "tab:red", "tab:blue", "black"
_MARGIN_M = 1.0
_DOTS_PER_INCH, _COLOURS = 110, 128
"""Of the files; they stay small enough to be kept in a repository."""


def can_plot() -> bool:
    """Whether matplotlib is there."""
    return importlib.util.find_spec("matplotlib") is not None


def plot_probabilities(name: str, traces: dict[Algorithm, Trace], folder: Path) -> Path:
    """Probabilities over time: a colour for each cluster; the right places' is dashed."""
    figure, axes = _panels(len(traces), (10.0, 2.8 * len(traces)), rows=True)
    for axis, (algorithm, trace) in zip(axes, traces.items(), strict=True):
        updates = [step.update for step in trace.steps]
        if algorithm == "cluster-mcl":
            _draw_clusters(axis, trace)
        else:
            best = [step.places[0].probability if step.places else 0.0 for step in trace.steps]
            axis.plot(updates, best, color=_OTHER, linewidth=0.8, label="most probable place")
        right = [step.truth_probability for step in trace.steps]
        axis.plot(updates, right, "--", color=_TRUTH, linewidth=0.9, label="right places together")
        axis.set(ylim=(-0.03, 1.03), ylabel="probability")
        axis.set_title(_title(name, algorithm, trace), fontsize="medium")
        axis.legend(loc="upper left", fontsize="small")
    axes[-1].set_xlabel("update")
    return _saved(figure, folder / f"{name}-probabilities.png")


def plot_trajectories(
    name: str, traces: dict[Algorithm, Trace], grid_map: GridMap, folder: Path
) -> Path:
    """Truth, estimates (right or wrong) and alternatives on the map."""
    width_m, height_m = grid_map.size_m
    rows = width_m > 1.5 * height_m
    size = (9.0, 1.0 + 18.0 * height_m / width_m) if rows else (9.0, 1.0 + 4.5 * height_m / width_m)
    figure, axes = _panels(len(traces), size, rows=rows)
    for axis, (algorithm, trace) in zip(axes, traces.items(), strict=True):
        _draw_map(axis, grid_map)
        _draw_trajectories(axis, trace)
        axis.set_title(_title(name, algorithm, trace), fontsize="medium")
        axis.legend(loc="upper right", fontsize="x-small", markerscale=2.0)
    return _saved(figure, folder / f"{name}-trajectories.png")


def plot_reliability(parts: dict[Algorithm, Reliability], folder: Path) -> Path:
    """What was claimed against what came true; below, how often it was claimed."""
    from matplotlib import pyplot  # noqa: PLC0415 - an extra, and slow to import

    figure, (upper, lower) = pyplot.subplots(
        2, 1, figsize=(5.5, 6.5), height_ratios=(3, 1), sharex=True, layout="constrained"
    )
    upper.plot([0, 1], [0, 1], ":", color="grey", label="as it should be")
    for index, (algorithm, part) in enumerate(parts.items()):
        shift = 0.02 * (index - (len(parts) - 1) / 2)
        held = [each for each in part.bins if each.claims]
        claimed, right = (
            [each.mean_probability for each in held],
            [each.right_share for each in held],
        )
        upper.plot(claimed, right, "o-", label=NAMES[algorithm])
        middles = (np.arange(len(part.bins)) + 0.5) / len(part.bins) + shift
        lower.bar(middles, [each.claims for each in part.bins], width=0.02)
    upper.set(ylabel="share that was right", title="Estimates, pooled over all experiments")
    upper.legend()
    lower.set(xlabel="claimed probability", ylabel="updates", yscale="symlog")
    return _saved(figure, folder / "reliability.png")


def _panels(
    count: int, size: tuple[float, float], *, rows: bool
) -> tuple["Figure", Sequence["Axes"]]:
    import matplotlib as mpl  # noqa: PLC0415 - an extra, and slow to import

    mpl.use("agg")
    from matplotlib import pyplot  # noqa: PLC0415 - an extra, and slow to import

    shape = (count, 1) if rows else (1, count)
    figure, axes = pyplot.subplots(*shape, figsize=size, squeeze=False, layout="constrained")
    return figure, list(axes.ravel())


def _title(name: str, algorithm: Algorithm, trace: Trace) -> str:
    """Which run it is, and below, what was found."""
    return f"{name}: {NAMES[algorithm]}, seed {trace.seed}\n{trace.finding}"


def _draw_clusters(axis: "Axes", trace: Trace) -> None:
    """A line for each cluster, as long as it lives; those that never mattered in grey."""
    lines: dict[int, list[tuple[int, float]]] = {}
    for step in trace.steps:
        for place in step.places:
            lines.setdefault(place.cluster, []).append((step.update, place.probability))
    for cluster, points in lines.items():
        updates, probabilities = zip(*points, strict=True)
        colour = f"C{cluster % 10}" if max(probabilities) > 0.1 else "lightgrey"
        axis.plot(updates, probabilities, color=colour, linewidth=0.8)


def _draw_map(axis: "Axes", grid_map: GridMap) -> None:
    """The map, cropped to what is known; yaw of the grid is left out of the picture."""
    shade = np.full(grid_map.cells.shape, 0.85)
    shade[grid_map.cells == FREE], shade[grid_map.cells == OCCUPIED] = 1.0, 0.2
    x, y, _ = grid_map.map_from_grid
    width_m, height_m = grid_map.size_m
    extent = (x, x + width_m, y, y + height_m)
    axis.imshow(shade, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent)
    known = np.argwhere(grid_map.cells != -1) * grid_map.cell_m
    (low_y, low_x), (high_y, high_x) = known.min(axis=0), known.max(axis=0)
    axis.set_xlim(x + low_x - _MARGIN_M, x + high_x + _MARGIN_M)
    axis.set_ylim(y + low_y - _MARGIN_M, y + high_y + _MARGIN_M)
    axis.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")


def _draw_trajectories(axis: "Axes", trace: Trace) -> None:
    others = [place for step in trace.steps for place in step.places[1:]]
    if others:
        shades = [min(1.0, 0.05 + place.probability) for place in others]
        _dots(axis, [p.position for p in others], 2.0, _OTHER, "alternatives", alpha=shades)
    best = [(step.places[0].position, step.right) for step in trace.steps if step.places]
    for right, colour, label in ((False, _WRONG, "wrong"), (True, _RIGHT, "right")):
        points = [position for position, was_right in best if was_right == right]
        if points:
            _dots(axis, points, 5.0, colour, f"estimate, {label}")
    truth = np.array([step.truth[:2] for step in trace.steps])
    axis.plot(truth[:, 0], truth[:, 1], color=_TRUTH, linewidth=0.6, label="truth")


def _dots(
    axis: "Axes",
    points: Sequence[tuple[float, float]],
    size: float,
    colour: str,
    label: str,
    **more: Any,
) -> None:
    x, y = np.array(points).T
    axis.scatter(x, y, s=size, color=colour, linewidths=0, label=label, **more)


def _saved(figure: "Figure", path: Path) -> Path:
    from matplotlib import pyplot  # noqa: PLC0415 - an extra, and slow to import

    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=_DOTS_PER_INCH)
    pyplot.close(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.open(drawn).convert("RGB")
    few = picture.quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)  # keeps rare hues
    few.save(path, optimize=True)
    return path
