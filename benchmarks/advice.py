"""How much sooner is an advised robot sure of its place than one that wanders?

    python -m benchmarks.advice [WORLD...] [--seeds N] [--first N]

Both robots of a seed begin at the same pose with the same noise. An advised robot drives the first
way of `ClusterMCL.advice` while several places are possible, and asks again at its end.
"""

import math
from dataclasses import dataclass, replace
from itertools import islice
from typing import Annotated

import numpy as np
import typer

from clustermcl import ClusterMCL, Reading
from grid_maps.grid_map import GridMap
from particle_filter.arrays import OCCUPIED
from particle_filter.poses import compose, inverse
from robot_simulator.simulation import Simulation
from robot_simulator.worlds.catalogue import world
from robot_simulator.worlds.world import World, world_from_map

RIGHT_M = 1.0
"""A place nearer than this to the robot is right [m]."""
MAX_WAY_STEPS = 120
"""Steps after which an advised robot asks again at the latest: more than any way needs."""


@dataclass(frozen=True)
class Run:
    """One robot from its start."""

    steps: int
    """Steps until it was sure and right, or the limit."""
    found: bool
    wrong: int
    """Steps that were sure and wrong."""
    made: int
    """Steps in all."""
    ways: tuple[tuple[float, float], ...]
    """For each way that was driven: predicted and gained information [nat]."""


def run(place: World, seed: int, limit: int, *, advised: bool) -> Run:
    """Drive until the robot is sure and right, at most `limit` steps."""
    simulation, mcl = Simulation(place, seed), ClusterMCL(place.map, seed=seed)
    ways: list[tuple[float, float]] = []
    predicted, before, until, wrong, made = math.nan, 0.0, -1, 0, 0
    for tick in islice(simulation, 40 * limit):
        for reading in tick.readings:
            belief = mcl.update(Reading.of(reading))
            if belief is None:
                continue
            made += 1
            truth = tick.map_from_robot
            right = belief.pose is not None and math.dist(belief.pose[:2], truth[:2]) < RIGHT_M
            sure = belief.state == "localized"
            wrong += sure and not right
            over = not simulation.follows or made >= until or sure
            if over and not math.isnan(predicted):
                ways.append((predicted, log_of_truth(belief, truth) - before))
                predicted = math.nan
            if (sure and right) or made >= limit:
                return Run(made, sure and right, wrong, made, tuple(ways))
            if advised and over and belief.state == "ambiguous":
                answer = mcl.advice(radius_m=0.25)
                if answer.ways:
                    way = answer.ways[0]
                    # The way begins at the scan's pose; the robot has turned a little since.
                    in_map = compose(np.array(truth), np.array(way.poses))
                    now = inverse(np.array(simulation.map_from_robot))
                    simulation.follow(compose(now, in_map)[1:, :2])
                    predicted, before = way.information, log_of_truth(belief, truth)
                    until = made + MAX_WAY_STEPS
    return Run(limit, False, wrong, made, tuple(ways))


def log_of_truth(belief: object, truth: tuple[float, float, float]) -> float:
    """Return the log of the probability of all places at the robot, at least 0.001."""
    near = (h for h in belief.hypotheses if math.dist(h.pose[:2], truth[:2]) < RIGHT_M)  # type: ignore[attr-defined]
    return math.log(max(math.fsum(h.probability for h in near), 0.001))


def place_of(name: str) -> World:
    """Return a world by name, with random starts; `hall_block`: `hall_symmetric` with one block."""
    if name == "hall_block":
        return _with_block(world("hall_symmetric").map)
    return replace(world(name), start=None, route=())


def _with_block(hall: GridMap) -> World:
    """Return a symmetric hall with a block of 1 m at its edge, as the only difference."""
    cells = hall.cells.copy()
    rows, cols = cells.shape
    cells[rows // 2 - 10 : rows // 2 + 10, cols - 70 : cols - 50] = OCCUPIED
    return world_from_map(replace(hall, cells=cells))


def main(
    worlds: Annotated[list[str] | None, typer.Argument(help="Worlds.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Robots in each world.")] = 24,
    first: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    limit: Annotated[int, typer.Option(min=1, help="Steps of a run.")] = 300,
) -> None:
    """Print for each world the steps of both robots, and predicted against gained information."""
    pairs: list[tuple[float, float]] = []
    for name in worlds or ("cross_feature", "hall_block", "office"):
        place = place_of(name)
        for advised in (False, True):
            runs = [
                run(place, seed, limit, advised=advised) for seed in range(first, first + seeds)
            ]
            steps = np.array([one.steps for one in runs])
            found, wrong = sum(one.found for one in runs), sum(one.wrong for one in runs)
            total = sum(one.made for one in runs)
            print(
                f"{name} {'advised  ' if advised else 'wandering'}: median {np.median(steps):.0f}, "
                f"90 % {np.quantile(steps, 0.9):.0f} steps; {found} of {seeds} found; "
                f"sure and wrong {wrong} of {total}; {steps.tolist()}",
                flush=True,
            )
            pairs += [pair for one in runs for pair in one.ways]
    if len(pairs) > 2:
        predicted, gained = np.array(pairs).T
        print(
            f"{len(pairs)} ways: correlation {np.corrcoef(predicted, gained)[0, 1]:.2f}, "
            f"predicted {predicted.mean():.2f}, gained {gained.mean():.2f} nat"
        )


if __name__ == "__main__":
    typer.run(main)
