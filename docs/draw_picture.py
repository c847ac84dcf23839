"""Draws docs/belief.png: the demo's robot in the cross, its four places, and how one wins.

python docs/draw_picture.py        (needs the extra `plots`)
"""

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from evaluation import in_process
from particle_filter.settings import FilterSettings
from process_runtime.settings import BridgeSettings
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.catalogue import world
from worker.map_model import sensor_model

STEPS, SHOWN_STEP = 190, 100
COLOURS = plt.get_cmap("tab10").colors


def main() -> None:
    """Run the demo's world in this process and draw it."""
    place, settings = world("cross_feature"), FilterSettings()
    source = SimulatedSource(Simulation(place, settings.seed), steps=STEPS)
    steps = list(simulated_steps(source, BridgeSettings(), place.map.digest))
    model = sensor_model(place.map, settings.sensor, cache_folder=None)
    outcomes = [
        outcome for _, outcome in in_process.outcomes((s for s, _ in steps), model, settings)
    ]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), width_ratios=(1, 1.4))
    width, height = place.map.size_m
    x, y, _ = place.map.map_from_grid
    left.imshow(
        np.where(place.map.cells == 1, 0.2, np.where(place.map.cells == 0, 1.0, 0.85)),
        origin="lower", extent=(x, x + width, y, y + height), cmap="gray", vmin=0, vmax=1,
    )  # fmt: skip
    left.plot(*np.array([truth for _, truth in steps[: SHOWN_STEP + 1]])[:, :2].T, "k:", lw=1)
    first = [h.cluster for h in outcomes[SHOWN_STEP].hypotheses[:4]]
    for hypothesis in outcomes[SHOWN_STEP].hypotheses[:4]:
        colour = COLOURS[first.index(hypothesis.cluster)]
        px, py, heading = hypothesis.mean
        left.plot(px, py, "o", ms=9, color=colour)
        left.arrow(px, py, np.cos(heading), np.sin(heading), width=0.12, color=colour)
        left.annotate(f"{hypothesis.probability:.2f}", (px, py), (8, 8),
                      textcoords="offset points", color=colour)  # fmt: skip
    left.set_title(f"step {SHOWN_STEP}: where the robot may be (dotted: its way)", fontsize=9)
    left.set_xlabel("x [m]")
    left.set_ylabel("y [m]")
    for number, cluster in enumerate(first):
        found = [
            {h.cluster: h.probability for h in outcome.hypotheses}.get(cluster, np.nan)
            for outcome in outcomes
        ]
        right.plot(found, color=COLOURS[number])
    right.set_title("probability of each place", fontsize=9)
    right.set_xlabel("step (0.2 m or 0.2 rad)")
    right.set_ylim(0.0, 1.0)
    figure.tight_layout()
    figure.savefig(Path(__file__).with_name("belief.png"), dpi=90)


if __name__ == "__main__":
    main()
