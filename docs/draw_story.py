"""Draws docs/story.webp: a robot among four equal arms, by ordinary MCL and by Cluster-MCL.

python docs/draw_story.py        (needs the extra `plots`)

The recordings in which ordinary MCL settles on a wrong place may not be published, so the robot is
simulated. Both filters get the same scans.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from moving_picture import write_webp
from PIL import Image

from benchmarks.experiments.baselines import ALGORITHMS
from benchmarks.experiments.case import Algorithm
from clustermcl.belief.outcome import Outcome
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.simulator.simulation import Simulation, simulated_steps
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.view.plots import draw_map, draw_places

WORLD, SEED, STEPS = "cross_feature", 3, 180
COMPARED: dict[Algorithm, str] = {"mcl": "ordinary MCL", "cluster-mcl": "Cluster-MCL"}
EVERY, PLAYED_FROM = 4, 140
"""Every fourth step is drawn; near the cabinet, from this step on, every second."""


def main() -> None:
    """Run both filters and write the picture."""
    runs = [list(run(algorithm)) for algorithm in COMPARED]
    chosen = [*range(0, PLAYED_FROM, EVERY), *range(PLAYED_FROM, STEPS, EVERY // 2)]
    frames = (side_by_side([steps[number] for steps in runs]) for number in chosen)
    file = Path(__file__).with_name("story.webp")
    write_webp(file, frames, frame_ms=120, last_frame_ms=4_000, quality=60)


def run(algorithm: Algorithm) -> Iterator[tuple[Scan, Outcome, PoseTuple]]:
    """Yield each scan, what the filter believes after it, and the true pose."""
    place, settings = world(WORLD), FilterSettings(seed=SEED)
    steps = list(simulated_steps(Simulation(place, SEED), BridgeSettings(), steps=STEPS))
    model = sensor_model(place.map, settings.sensor, cache_folder=None)
    believed = ALGORITHMS[algorithm]((scan for scan, _ in steps), model, settings)
    for (scan, outcome), (_, truth) in zip(believed, steps, strict=True):
        yield scan, outcome, truth


def side_by_side(moments: list[tuple[Scan, Outcome, PoseTuple]]) -> Image.Image:
    """Draw one step of each filter, with its name and its state."""
    figure = Figure(figsize=(9.6, 5.2), dpi=100, layout="constrained")
    sides = figure.subplots(1, len(moments))
    for axes, name, (scan, outcome, truth) in zip(sides, COMPARED.values(), moments, strict=True):
        draw_map(axes, world(WORLD).map)
        draw_places(axes, outcome.hypotheses, scan, truth)
        axes.set(xticks=[], yticks=[], xlabel="", ylabel="")
        axes.set_title(f"{name}: {outcome.state}", fontsize=16)
    sides[-1].legend(*sides[-1].get_legend_handles_labels(), loc="lower right")
    sides[0].text(0.02, 0.02, f"step {scan.step}", transform=sides[0].transAxes, fontsize=12)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba()))


if __name__ == "__main__":
    main()
