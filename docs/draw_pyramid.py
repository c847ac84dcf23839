"""Draws docs/pyramid.png: one heading of a search, from coarse tiles to leaves.

python docs/draw_pyramid.py        (needs the extra `plots`)
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from clustermcl.filter.laser.evidence_model import scan_exponent
from clustermcl.filter.laser.pyramid import sum_steps
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.scan_arrays import scan_beams
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.catalogue import world


def main() -> None:
    """Score one scan with the robot's true heading on every level, and draw the bounds."""
    place, settings = world("hall"), FilterSettings()
    scan, truth = next(simulated_steps(Simulation(place, settings.seed), BridgeSettings()))
    model = sensor_model(place.map, settings.sensor, cache_folder=None)
    beams = scan_beams(scan, model)
    heading = truth[2] - model.grid.map_from_grid[2]
    c, s = np.cos(heading), np.sin(heading)
    x, y = beams.hits_in_robot.T / model.grid.cell_m
    offsets = np.floor(np.stack([s * x + c * y, c * x - s * y], -1)).astype(np.int64)
    left, low, _ = place.map.map_from_grid
    width, height = place.map.size_m
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.4), sharey=True)
    shade = np.where(place.map.cells == 1, 0.1, np.where(place.map.cells == 0, 1.0, 0.8))
    extent = (left, left + width, low, low + height)
    axes[0].imshow(shade, cmap="gray", vmin=0, vmax=1, origin="lower", extent=extent)
    axes[0].set_title("map and robot")
    exponent = scan_exponent(beams.count, model.settings)
    scale = exponent * model.pyramid.log_step
    leaf = model.pyramid.levels[-1]
    rows, cols = (size - 1 for size in leaf.shape[2:])
    best = scale * float(
        sum_steps(leaf, offsets, np.array([(r, 0, cols) for r in range(rows)])).max()
    )
    for axis, level in zip(axes[1:], model.pyramid.levels, strict=True):
        rows, cols = (size - 1 for size in level.shape[2:])
        sums = sum_steps(level, offsets, np.array([(r, 0, cols) for r in range(rows)]))
        below = scale * sums.reshape(rows, cols) - best
        side_m = len(level) * model.grid.cell_m
        left_share = np.mean(below >= -settings.search.margin)
        image = axis.imshow(
            below, cmap="viridis", vmin=-30.0, vmax=0.0, origin="lower",
            extent=(left, left + cols * side_m, low, low + rows * side_m),
        )  # fmt: skip
        what = "leaves" if level is leaf else "tiles"
        axis.set_title(f"{what} of {side_m:.1f} m: {left_share:.1%} left")
    for axis in axes:
        axis.plot(*truth[:2], "r+", markersize=12)
        axis.set(xlim=extent[:2], ylim=extent[2:])
    figure.colorbar(image, ax=axes, label="below the best leaf [nat]", shrink=0.9)
    figure.savefig(Path(__file__).with_name("pyramid.png"), dpi=110, bbox_inches="tight")


if __name__ == "__main__":
    main()
