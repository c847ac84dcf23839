"""Draws docs/story.gif and docs/story.png: the demo's robot in the cross, from real runs.

python docs/draw_story.py
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from coordinator.belief.outcome import Outcome
from evaluation.experiments.case import ALGORITHMS, NAMES, Algorithm
from grid_maps.grid_map import GridMap
from particle_filter.arrays import FREE, OCCUPIED
from particle_filter.settings import FilterSettings
from process_runtime.settings import BridgeSettings
from protocol.message import PoseTuple
from robot_simulator.simulation import Simulation
from robot_simulator.source import SimulatedSource, simulated_steps
from robot_simulator.worlds.catalogue import world
from worker.map_model import sensor_model

HERE = Path(__file__).parent
STEPS, SHOWN_STEP = 190, 100
FRAME_EVERY, FRAME_MS, LAST_FRAME_MS = 3, 110, 3_000
MAP_PX, PLOT_PX, FINER = 400, 380, 2
"""Factor by which it is drawn finer than shown, which makes edges smooth."""
PAPER, INK, FAINT, GROUND = (255, 255, 255), (40, 44, 52), (150, 155, 165), (236, 238, 242)
COLOURS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (213, 94, 0))
"""Okabe and Ito's, which the colour-blind can distinguish."""


@dataclass(frozen=True)
class Story:
    """A run from its beginning to its end."""

    algorithm: str
    plan: GridMap
    outcomes: Sequence[Outcome]
    truths: Sequence[PoseTuple]
    clusters: Sequence[int]
    """Those that are drawn, in the order of their colours."""


def main() -> None:
    """Run it, and draw both pictures."""
    story, ordinary = told("cluster-mcl"), told("mcl")
    shown = [(ordinary, SHOWN_STEP), (story, SHOWN_STEP), (story, STEPS - 2)]
    strip = Image.new("RGB", (len(shown) * MAP_PX, MAP_PX), PAPER)
    for place, (told_by, step) in enumerate(shown):
        strip.paste(map_picture(told_by, step), (place * MAP_PX, 0))
    palette = strip.quantize(128, method=Image.Quantize.MAXCOVERAGE)
    palette.save(HERE / "story.png", optimize=True)
    frames = [frame(story, step) for step in range(0, STEPS, FRAME_EVERY)]
    flat = [one.quantize(palette=palette, dither=Image.Dither.NONE) for one in frames]
    flat[0].save(
        HERE / "story.gif",
        save_all=True,
        append_images=flat[1:],
        duration=[FRAME_MS] * (len(flat) - 1) + [LAST_FRAME_MS],
        loop=0,
        optimize=True,
    )


def told(algorithm: Algorithm) -> Story:
    """The demo's run, in this process."""
    place, settings = world("cross_feature"), FilterSettings()
    source = SimulatedSource(Simulation(place, settings.seed), steps=STEPS)
    steps = list(simulated_steps(source, BridgeSettings(), place.map.digest))
    model = sensor_model(place.map, settings.sensor, cache_folder=None)
    run = ALGORITHMS[algorithm]((scan for scan, _ in steps), model, settings)
    outcomes = [outcome for _, outcome in run]
    held = (h.cluster for outcome in outcomes for h in outcome.hypotheses if h.cluster >= 0)
    clusters = list(dict.fromkeys(held))[: len(COLOURS)]
    truths = [truth for _, truth in steps]
    return Story(NAMES[algorithm], place.map, outcomes, truths, clusters)


def frame(story: Story, step: int) -> Image.Image:
    """The map, and the probabilities up to a step."""
    picture = Image.new("RGB", (MAP_PX + PLOT_PX, MAP_PX), PAPER)
    picture.paste(map_picture(story, step), (0, 0))
    picture.paste(plot_picture(story, step), (MAP_PX, 0))
    return picture


def map_picture(story: Story, step: int) -> Image.Image:
    """Where the robot may be at a step; dotted, where it really was."""
    plan, size = story.plan, MAP_PX * FINER
    rows, cols = plan.cells.shape
    per_m = size / (max(rows, cols) * plan.cell_m)
    tone = np.full((rows, cols, 3), PAPER, np.uint8)
    tone[plan.cells == FREE], tone[plan.cells == OCCUPIED] = GROUND, INK
    picture = Image.fromarray(tone[::-1]).resize((size, size), Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(picture)
    left, low, _ = plan.map_from_grid

    def pixel(x: float, y: float) -> tuple[float, float]:
        return (x - left) * per_m, size - (y - low) * per_m

    for x, y, _ in story.truths[: step + 1]:
        _disc(draw, pixel(x, y), 1.2 * FINER, FAINT)
    for hypothesis in story.outcomes[step].hypotheses:
        if hypothesis.cluster >= 0 and hypothesis.probability < 0.01:
            continue
        colour = colour_of(story, hypothesis.cluster)
        x, y, heading = hypothesis.mean
        middle, radius = pixel(x, y), (4 + 14 * math.sqrt(hypothesis.probability)) * FINER
        corners = ((heading, 1.7), (heading + 1.0, 1.0), (heading - 1.0, 1.0))
        nose = [
            (middle[0] + far * radius * math.cos(at), middle[1] - far * radius * math.sin(at))
            for at, far in corners
        ]
        draw.polygon(nose, fill=colour)
        _disc(draw, middle, radius, colour)
        if hypothesis.cluster >= 0:
            at = middle[0] + 1.3 * radius, middle[1] + 0.8 * radius
            words = f"{hypothesis.probability:.0%}"
            draw.text(at, words, colour, _font(15), stroke_width=FINER, stroke_fill=PAPER)
    for line, words in enumerate((story.algorithm, f"step {step}", story.outcomes[step].state)):
        draw.text((10 * FINER, (10 + 20 * line) * FINER), words, INK, _font(15))
    return picture.resize((MAP_PX, MAP_PX), Image.Resampling.LANCZOS)


def plot_picture(story: Story, step: int) -> Image.Image:
    """The probability of each place, up to a step."""
    width, height = PLOT_PX * FINER, MAP_PX * FINER
    left, right, top, low = 40 * FINER, width - 20 * FINER, 50 * FINER, height - 40 * FINER
    picture = Image.new("RGB", (width, height), PAPER)
    draw = ImageDraw.Draw(picture)
    draw.text((left, 18 * FINER), "how probable each place is", INK, _font(15))
    for tenth in (0, 5, 10):
        y = low + (top - low) * tenth / 10
        draw.line([(left, y), (right, y)], GROUND, FINER)
        draw.text((left - 6 * FINER, y), f"{tenth / 10:.0%}", FAINT, _font(11), anchor="rm")
    for mark in (0, 50, 100, 150):
        x = left + (right - left) * mark / STEPS
        draw.text((x, low + 8 * FINER), str(mark), FAINT, _font(11), anchor="mt")
    draw.text(((left + right) / 2, low + 24 * FINER), "step", FAINT, _font(11), anchor="mt")
    for drawn, cluster in enumerate(story.clusters):  # equal ones: stripes within stripes
        points = [
            (
                left + (right - left) * at / STEPS,
                low + (top - low) * hypothesis.probability,
            )
            for at, outcome in enumerate(story.outcomes[: step + 1])
            for hypothesis in outcome.hypotheses
            if hypothesis.cluster == cluster
        ]
        if len(points) > 1:
            width = 3 * (len(story.clusters) - drawn) * FINER
            draw.line(points, colour_of(story, cluster), width, joint="curve")
    return picture.resize((PLOT_PX, MAP_PX), Image.Resampling.LANCZOS)


def colour_of(story: Story, cluster: int) -> tuple[int, int, int]:
    """Its own; grey for places that are no clusters yet."""
    return COLOURS[story.clusters.index(cluster)] if cluster in story.clusters else FAINT


def _disc(
    draw: ImageDraw.ImageDraw, at: tuple[float, float], radius: float, colour: tuple[int, int, int]
) -> None:
    draw.ellipse((at[0] - radius, at[1] - radius, at[0] + radius, at[1] + radius), fill=colour)


def _font(points: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(points * FINER)


if __name__ == "__main__":
    main()
