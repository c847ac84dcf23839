"""How much sooner is an advised robot sure of its place than one that wanders?

    python -m benchmarks.advice [WORLD...] [--seeds N] [--first N] [--whole [--output FILE]]

Both robots of a seed begin at the same pose with the same noise. An advised robot drives the first
way of `ClusterMCL.advice` while several places are possible. It asks again after a few steps,
because the places change while it drives.
"""

import csv
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.worlds import world
from clustermcl import ClusterMCL, Reading
from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Poses
from clustermcl.filter.poses import compose, inverse, wrap_angle
from clustermcl.protocol.advice import LEAST_PROBABILITY, Advice, Way
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.message import PoseTuple
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.world import World, world_from_map

RIGHT_M, RIGHT_RAD = 1.0, 0.5
"""A place nearer than this to the robot is right."""
RADIUS_M = 0.25
"""Radius that ways are asked for [m]; the simulated robot is smaller."""
ASK_STEPS = 10
"""Steps after which a robot on an advised way asks again, if the number of places has changed.
While it is the same, another of several equally good ways would only make the robot turn back."""
MAX_WAY_STEPS = 120
"""Steps after which an advised robot asks again on the longest way."""
BINS = (0.25, 0.5, 1.0)
"""Limits of the predicted gains that are compared with real ones [nat]."""
SHARES = (0.0, 0.25, 0.5, 0.75)
"""Where poses between two of a way are checked."""
TOLERANCE_M = 0.04
"""A robot that already stands closer than its radius may come closer by this [m]."""
WAIT_STEPS = 5
"""Without a way, a robot wanders for as long before it asks again."""


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
    ways: tuple[tuple[float, float, float], ...]
    """For each whole way that was driven: predicted information, predicted gain of the right place,
    and its gain [nat]."""
    checked: int
    """Poses of advised ways at each place and at the true pose."""
    unsafe: int
    """Those nearer to an obstacle than `RADIUS_M`, and than the robot when it asked; or in one."""


class Obstacles:
    """Exact distances to the cells of a map that are not free, and to its border."""

    def __init__(self, grid_map: GridMap) -> None:
        rows, cols = np.nonzero(np.pad(grid_map.cells, 1, constant_values=UNKNOWN) != FREE)
        self._half_m, self._grid_from_map = grid_map.cell_m / 2.0, inverse(grid_map.map_from_grid)
        self._middles = cKDTree((np.column_stack([cols, rows]) - 0.5) * grid_map.cell_m)

    def distance_m(self, map_from_robot: Poses) -> NDArray[np.float64]:
        """Return the (n,) distances of (n, 3) poses [m]."""
        points = compose(self._grid_from_map, map_from_robot)[:, :2]
        _, near = self._middles.query(points, 8)
        off = np.abs(points[:, None] - self._middles.data[near]) - self._half_m
        return np.asarray(np.hypot(*np.maximum(off, 0.0).T).min(axis=0))

    def count_unsafe(self, way: Way, places: Iterable[PoseTuple]) -> tuple[int, int]:
        """Return how many poses of a way were checked at some places, and how many are unsafe."""
        poses = np.array(way.poses)
        dense = np.concatenate([poses[:-1] + share * np.diff(poses, axis=0) for share in SHARES])
        room = np.array([self.distance_m(compose(np.array(place), dense)) for place in places])
        least = np.minimum(RADIUS_M, room[:, :1] - TOLERANCE_M)
        moves = np.hypot(*dense[:, :2].T) > 0.0
        return room.size, int(((room < least) | (room == 0.0) & moves).sum())


def run(place: World, seed: int, limit: int, *, advised: bool, whole: bool = False) -> Run:
    """Drive until the robot is sure and right, at most `limit` steps."""
    simulation, mcl = Simulation(place, seed), ClusterMCL(place.map, seed=seed)
    obstacles, checks = Obstacles(place.map), [(0, 0)]
    ways: list[tuple[float, float, float]] = []
    begun, until, waits, wrong, made, found = None, -1, -1, 0, 0, False
    soon = places_asked = 0
    for tick in islice(simulation, 40 * limit):
        for belief in filter(None, map(mcl.update, map(Reading.of, tick.readings))):
            made, truth = made + 1, tick.map_from_robot
            sure = belief.state == "localized"
            found = sure and belief.pose is not None and is_right(belief.pose, truth)
            wrong += sure and not found
            over = not simulation.robot.follows or made >= until or sure
            over |= not whole and made >= soon and count_places(belief) != places_asked
            if over and begun:
                ways.append((begun[0], begun[1], log_of_truth(belief, truth) - begun[2]))
                begun = None
            if not found and advised and over and made > waits and belief.state == "ambiguous":
                answer = mcl.advice(radius_m=RADIUS_M)
                places = *answer.places, truth
                until, soon, places_asked = (
                    made + MAX_WAY_STEPS,
                    made + ASK_STEPS,
                    count_places(belief),
                )
                waits = made + (0 if answer.ways else WAIT_STEPS)
                checks += [obstacles.count_unsafe(way, places) for way in answer.ways]
                for way in answer.ways[:1]:
                    follow(simulation, np.array(way.poses + way.rest * whole), truth)
                    if whole:
                        gain = gain_of_truth(answer, way, truth)
                        begun = way.information, gain, log_of_truth(belief, truth)
        if found or made >= limit:
            break
    checked, unsafe = np.sum(checks, axis=0).tolist()
    return Run(made if found else limit, found, wrong, made, tuple(ways), checked, unsafe)


def count_places(belief: Belief) -> int:
    return sum(place.probability >= LEAST_PROBABILITY for place in belief.hypotheses)


def follow(simulation: Simulation, way: Poses, begin: PoseTuple) -> None:
    """Drive along a way, or turn once if it has no length; then drive to random goals.

    Its (n, 3) poses are relative to the pose in the map where it begins.
    """
    if np.ptp(way[:, :2], axis=0).any():
        simulation.robot.follow(compose(np.array(begin), way)[1:, :2])
    else:
        simulation.robot.turn_round()


def is_right(pose: PoseTuple, truth: PoseTuple) -> bool:
    near = math.dist(pose[:2], truth[:2]) < RIGHT_M
    return near and abs(wrap_angle(pose[2] - truth[2])) < RIGHT_RAD


def log_of_truth(belief: Belief, truth: PoseTuple) -> float:
    """Return the log of the probability of all places at the robot, at least 0.001."""
    near = (place for place in belief.hypotheses if is_right(place.pose, truth))
    return math.log(max(math.fsum(place.probability for place in near), 0.001))


def gain_of_truth(answer: Advice, way: Way, truth: PoseTuple) -> float:
    """Return the predicted gain of the right place; NaN: the robot is at none of the places."""
    gains = zip(way.gains, answer.places, strict=True)
    return next((gain for gain, place in gains if is_right(place, truth)), math.nan)


def print_calibration(pairs: list[tuple[float, float, float]]) -> None:
    """Print predicted against gained information, for all ways and by the predicted gain."""
    for name, column in (("information", 0), ("gain of the right place", 1)):
        rows = np.array([(pair[column], pair[2]) for pair in pairs if not math.isnan(pair[1])])
        if len(rows) < 3:
            return
        correlation = np.corrcoef(rows.T)[0, 1]
        print(f"{len(rows)} ways, {name}: correlation with the gain {correlation:.2f}")
        bins = np.digitize(rows[:, 0], BINS)
        for part in [rows] + [rows[bins == number] for number in np.unique(bins)]:
            predicted, gained = part.mean(axis=0)
            print(f"  {len(part)} ways: {predicted:.2f} nat predicted, {gained:.2f} gained")


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
    whole: Annotated[
        bool, typer.Option(help="Drive whole ways, without asking again; no robot wanders.")
    ] = False,
    output: Annotated[Path | None, typer.Option(help="CSV file of the whole ways.")] = None,
) -> None:
    """Print for each world the steps of both robots, and predicted against gained information."""
    pairs: list[tuple[float, float, float]] = []
    checked = unsafe = 0
    for name in worlds or ("cross_feature", "hall_block", "office"):
        place = place_of(name)
        for advised in (True,) if whole else (False, True):
            runs = [
                run(place, seed, limit, advised=advised, whole=whole)
                for seed in range(first, first + seeds)
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
            checked += sum(one.checked for one in runs)
            unsafe += sum(one.unsafe for one in runs)
    print(f"{unsafe} of {checked} poses of ways too near to an obstacle")
    print_calibration(pairs)
    if output is not None:
        with output.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(("information", "gain_of_right_place", "gained"))
            table.writerows([f"{value:.3f}" for value in pair] for pair in pairs)


if __name__ == "__main__":
    typer.run(main)
