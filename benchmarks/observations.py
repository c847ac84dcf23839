"""How much do tags, reflectors and position fixes help, and how much do wrong ones harm?

    python -m benchmarks.observations [ROW...] [--seeds N]

Each row is a simulated condition; the docstring of its function describes it.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Annotated

import msgspec
import numpy as np
import typer

from benchmarks.worlds import world
from clustermcl import ClusterMCL, Reading
from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.kind import Landmarks
from clustermcl.filter.observations.likelihood import ObservationArrays, log_ratios
from clustermcl.filter.observations.sighting import Sighting
from clustermcl.filter.poses import compose
from clustermcl.localizer import Belief
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Landmark, Observation
from clustermcl.simulator.sensors import Camera, Lidar, LidarModel
from clustermcl.simulator.simulation import Simulation, Tick
from clustermcl.simulator.worlds.office import office
from clustermcl.simulator.worlds.world import World

RIGHT_M = 1.0
"""A place nearer than this to the robot is right."""
ROOM_M, WING_M = 5.0, 14.6
"""Distances at which the rooms and the wings of the office repeat [m]."""
REFLECTORS = (
    (-12.0, -8.0), (-9.0, -8.2), (-3.0, -8.3), (4.0, -8.2), (11.0, -8.0), (12.2, -3.0),
    (12.2, 2.0), (12.0, 7.5), (5.0, 8.2), (-2.0, 8.3), (-11.0, 8.1), (-12.3, 5.0),
)  # fmt: skip
"""x, y in the symmetric hall [m]; they are not symmetric."""


@dataclass(frozen=True, kw_only=True)
class Gnss:
    """A receiver of satellite positions: one fix a second.

    A share of the fixes, `outliers`, is wrong by 50 m in a random direction.
    """

    sigma_m: float = 5.0
    bias_m: tuple[float, float] = (0.0, 0.0)
    outliers: float = 0.1

    def observe(
        self,
        stamp_ns: int,
        map_from_robot: PoseTuple,
        _landmarks: Sequence[Landmark],
        rng: np.random.Generator,
    ) -> Iterator[Observation]:
        """Yield the fix of a second, at the first tenth of it."""
        if stamp_ns % 10**9 >= 10**8:
            return
        angle = rng.uniform(-np.pi, np.pi)
        wrong_m = 50.0 * float(rng.random() < self.outliers)
        error = wrong_m * np.array([np.cos(angle), np.sin(angle)])
        fix = np.array(map_from_robot[:2]) + np.array(self.bias_m) + error
        yield Observation(
            sender="gnss",
            stamp_ns=stamp_ns,
            mean=tuple((fix + self.sigma_m * rng.standard_normal(2)).tolist()),
            covariance=(self.sigma_m**2, 0.0, 0.0, self.sigma_m**2),
            outlier_probability=max(self.outliers, 0.05),
            correlation_s=0.5,
        )


@dataclass(frozen=True)
class Step:
    """One step of a run."""

    belief: Belief
    tick: Tick
    has_seen: bool
    """Something has been observed up to this step."""

    @property
    def error_m(self) -> float:
        """Distance of the most probable place from the robot; infinite: there is no place."""
        pose = self.belief.pose
        return math.inf if pose is None else math.dist(pose[:2], self.tick.map_from_robot[:2])

    @property
    def is_right(self) -> bool:
        return self.error_m < RIGHT_M

    @property
    def is_sure(self) -> bool:
        return self.belief.state == "localized"

    @property
    def log_score(self) -> float:
        """Log of the probability of all places at the robot, at least 0.001."""
        at = self.tick.map_from_robot[:2]
        near = (h for h in self.belief.hypotheses if math.dist(h.pose[:2], at) < RIGHT_M)
        return math.log(max(math.fsum(h.probability for h in near), 0.001))


def run(
    in_world: World,
    seed: int,
    ticks: int,
    *,
    observes: bool = True,
    mapped: tuple[Landmark, ...] | None = None,
    knows_start: bool = False,
    simulation: Simulation | None = None,
    mcl: ClusterMCL | None = None,
) -> Iterator[Step]:
    """Yield the steps of a run.

    Args:
        in_world: the world.
        seed: of robot and filter.
        ticks: length of the run [0.1 s].
        observes: whether the filter gets the observations.
        mapped: landmarks of the map; None: those of the world.
        knows_start: whether the filter gets the start pose.
        simulation: continue this one.
        mcl: continue with this filter.
    """
    simulation = simulation or Simulation(in_world, seed)
    landmarks = in_world.landmarks if mapped is None else mapped
    mcl = mcl or ClusterMCL(in_world.map, landmarks=landmarks, seed=seed)
    if knows_start:
        mcl.set_pose(simulation.map_from_robot)
    has_seen = False
    for tick in islice(simulation, ticks):
        for seen in tick.observations if observes else ():
            has_seen = True
            side = len(seen.mean)
            mcl.observe(
                seen.mean, np.reshape(seen.covariance, (side, side)), landmark=seen.landmark,
                stamp_ns=seen.stamp_ns, source=seen.sender, correlation_s=seen.correlation_s,
                outlier_probability=seen.outlier_probability,
            )  # fmt: skip
        for reading in tick.readings:
            if belief := mcl.update(Reading.of(reading)):
                yield Step(belief, tick, has_seen)


def with_false_names(share: float) -> World:
    """Return the cross with tags, from random starts."""
    return replace(
        world("cross_tags"), start=None, route=(), observe=Camera(false_names=share).observe
    )


def cross(seeds: int) -> str:
    """A cross of four equal arms with a tag in two: sure and right one step after a sight."""
    found = []
    for seed in range(seeds):
        after = list(islice((s for s in run(with_false_names(0.0), seed, 4000) if s.has_seen), 2))
        found += [step.is_sure and step.is_right for step in after[1:]]
    return f"{sum(found)} of {len(found)}, and {seeds - len(found)} saw no tag"


def false_names(seeds: int) -> str:
    """The cross with 10 % of wrong names: steps that are sure and wrong."""
    steps = [step for seed in range(seeds) for step in run(with_false_names(0.1), seed, 400)]
    wrong = sum(step.is_sure and not step.is_right for step in steps)
    return f"{wrong} of {len(steps)} steps, {100.0 * wrong / len(steps):.2f} %"


def _before(seed: int, place: World) -> tuple[World, Landmark, Simulation]:
    """Return the world with a tag before the start, the tag, and the robot there."""
    at = np.array(Simulation(place, seed).map_from_robot)
    x, y, _ = compose(at, np.array([1.5, 0.4, 0.0])).tolist()
    tag = Landmark(name="exit", x=x, y=y, sigma=0.05)
    tagged = replace(place, landmarks=(tag,), observe=Camera(range_m=8.0).observe)
    return tagged, tag, Simulation(tagged, seed)


def moved_tag(seeds: int) -> str:
    """A tag in an office, moved by 2 m: found broken, and steps that are right."""
    broken, sights, steps = 0, [], []
    for seed in range(seeds):
        tagged, tag, simulation = _before(seed, world("office"))
        mapped = (replace_landmark(tag, tag.x - 2.0),)
        mcl = ClusterMCL(tagged.map, landmarks=mapped, seed=seed)
        made = list(run(tagged, seed, 150, knows_start=True, simulation=simulation, mcl=mcl))
        steps += made
        broken += any("broken" in cause for cause in mcl.dropped)
        sights.append(math.fsum(o.share for s in made for o in s.belief.scan.observations))
    right = sum(step.is_right for step in steps)
    wrong = sum(step.is_sure and not step.is_right for step in steps)
    return (
        f"broken in {broken} of {seeds} after at most {max(sights):.1f} independent sights; "
        f"right at {right} of {len(steps)} steps, sure and wrong at {wrong}"
    )


def replace_landmark(tag: Landmark, x: float) -> Landmark:
    """Return a tag at another x [m]."""
    return Landmark(name=tag.name, x=x, y=tag.y, sigma=tag.sigma)


def gnss(seeds: int) -> str:
    """An office of 50,000 m2 and fixes of 5 m, 10 % of them wrong by 50 m: right within 5 steps.

    Also for the exact posterior of `among_copies`, and without fixes.
    """
    large, firsts, exact, chances = replace(office(14, 54), observe=Gnss().observe), [], [], []
    for seed in range(seeds):
        steps = list(run(large, seed, 150))
        firsts.append(next((s.belief.step for s in steps if s.is_right), math.inf))
        stamps = [s.tick.laser.stamp_ns for s in steps if s.belief.step <= 5]
        posteriors = among_copies(large, seed, stamps)
        exact.append(any(is_right for is_right, _ in posteriors))
        chances.append(posteriors[-1][1])
    alone = [
        any(s.is_right for s in run(large, seed, 150, observes=False) if s.belief.step <= 5)
        for seed in range(seeds)
    ]
    return (
        f"{sum(first <= 5 for first in firsts)} of {seeds} ({firsts}), exact posterior "
        f"{sum(exact)} of {seeds}, mean probability of its best place at step 5 "
        f"{np.mean(chances):.2f}, without fixes {sum(alone)}"
    )


def among_copies(in_world: World, seed: int, stamps: list[int]) -> list[tuple[bool, float]]:
    """Return the posterior of the true way among its copies, moved by whole rooms and wings.

    The way is known, and so are the errors of laser and fixes. A copy is possible as long as at
    most four beams differ from the true scan by 0.15 m. So no filter can find the place more often.

    Returns:
        At the scan of each stamp, whether the most probable copy is the true one, and the
        probability of the most probable copy.
    """
    perfect, found = LidarModel(range_noise_m=0.0, drop_out_share=0.0), []
    lidar = Lidar(perfect, in_world.truth, np.random.default_rng(0))
    rooms, wings = np.meshgrid(np.arange(-18, 19), np.arange(-6, 7))
    offsets = np.stack([ROOM_M * rooms, WING_M * wings], axis=-1).reshape(-1, 2)
    logs = np.where(np.any(offsets != 0.0, axis=-1), 0.0, 1e-9)
    for tick in islice(Simulation(in_world, seed), math.ceil(stamps[-1] / 1e8)):
        x, y, heading = tick.map_from_robot
        ways = np.array([x, y]) + offsets
        for seen in tick.observations:
            off_m = np.hypot(*(ways - seen.mean).T)
            right = 0.9 * np.exp(-0.5 * (off_m / 5.0) ** 2) / (math.tau * 25.0)
            ring = np.exp(-0.5 * ((off_m - 50.0) / 5.0) ** 2) / (math.sqrt(math.tau) * 5.0)
            logs += np.log(right + 0.1 * ring / (math.tau * np.maximum(off_m, 5.0)) + 1e-300)
        if tick.laser.stamp_ns not in stamps:
            continue
        true = np.minimum(lidar.scan((x, y, heading)), perfect.range_max_m)
        for index in np.flatnonzero(logs > -np.inf):
            ranges = lidar.scan((*ways[index].tolist(), heading))
            off_m = np.abs(np.minimum(ranges, perfect.range_max_m) - true)
            if np.count_nonzero(off_m > 0.15) > 4:
                logs[index] = -np.inf
        best = int(np.argmax(logs))
        probability = 1.0 / np.exp(logs - logs[best]).sum()
        found.append((not offsets[best].any(), float(probability)))
    return found


def reflectors(seeds: int) -> str:
    """Twelve equal reflectors, symmetric hall: runs with a better log score than the laser's."""
    marks = tuple(Landmark(name="reflector", x=x, y=y, sigma=0.05) for x, y in REFLECTORS)
    hall = replace(world("hall_symmetric"), landmarks=marks, observe=Camera(range_m=8.0).observe)
    scores = np.array(
        [
            [
                np.mean([s.log_score for s in run(hall, seed, 300, observes=o)])
                for o in (True, False)
            ]
            for seed in range(seeds)
        ]
    )
    better = int(np.count_nonzero(scores[:, 0] > scores[:, 1]))
    with_them, alone = scores.mean(axis=0)
    return f"{better} of {seeds}; mean score {with_them:.2f}, of the laser alone {alone:.2f} nat"


def biased_fix(seeds: int) -> str:
    """A hall and fixes of 5 m with a constant error of 3 m: error while tracked, of the laser's."""
    hall = replace(world("hall"), observe=Gnss(bias_m=(3.0, 0.0), outliers=0.0).observe)
    rms = []
    for observes in (True, False):
        steps = [
            step
            for seed in range(seeds)
            for step in run(hall, seed, 300, observes=observes, knows_start=True)
        ]
        rms.append(math.sqrt(np.mean([step.error_m**2 for step in steps])))
    return (
        f"{rms[0]:.3f} m, of the laser alone {rms[1]:.3f} m: {100 * (rms[0] / rms[1] - 1):+.0f} %"
    )


class DriftingFixes(Simulation):
    """A robot whose fixes have an error of 5 m with a time constant of 30 s.

    Args:
        in_world: its sensor is a receiver without errors.
        seed: of robot and errors.
        stated_s: the time constant that the receiver states.
    """

    def __init__(self, in_world: World, seed: int, stated_s: float) -> None:
        super().__init__(in_world, seed)
        self._drift_rng, self._stated_s = np.random.default_rng([seed, 6]), stated_s
        self._error_m = 5.0 * self._drift_rng.standard_normal(2)

    def __next__(self) -> Tick:
        tick, kept = super().__next__(), math.exp(-0.1 / 30.0)
        new = 5.0 * math.sqrt(1.0 - kept**2) * self._drift_rng.standard_normal(2)
        self._error_m = kept * self._error_m + new
        drifted = (
            msgspec.structs.replace(
                seen, mean=tuple((seen.mean + self._error_m).tolist()),
                covariance=(25.0, 0.0, 0.0, 25.0), correlation_s=self._stated_s,
            )
            for seen in tick.observations
        )  # fmt: skip
        return replace(tick, observations=tuple(drifted))


def correlation(seeds: int) -> str:
    """Fixes whose error has a time constant of 30 s: that measured while tracked in the hall.

    And in the office, by the time that the receiver states, steps sure and wrong.
    """
    receiver = Gnss(sigma_m=1e-3, outliers=0.0)
    hall, texts = replace(world("hall"), observe=receiver.observe), []
    tracked = run(hall, 0, 6000, knows_start=True, simulation=DriftingFixes(hall, 0, 30.0))
    rows = [
        (seen.stamp_ns * 1e-9, *np.subtract(seen.mean, step.belief.hypotheses[0].pose[:2]))
        for step in tracked
        for seen in step.tick.observations
    ]
    stamps_s, off_m = np.array(rows)[:, 0], np.array(rows)[:, 1:]
    off_m -= off_m.mean(axis=0)
    apart_s, products = stamps_s[:, None] - stamps_s, off_m @ off_m.T
    ratios = (
        products[abs(apart_s - delay_s) < 2.0].mean() / np.diag(products).mean()
        for delay_s in range(200)
    )
    measured_s = next(delay_s for delay_s, ratio in enumerate(ratios) if ratio < 0.37)
    texts.append(f"measured {measured_s} s")
    place = replace(world("office"), observe=receiver.observe)
    for stated_s in (0.5, 5.0, 30.0, 120.0):
        steps = [
            step
            for seed in range(seeds)
            for step in run(place, seed, 200, simulation=DriftingFixes(place, seed, stated_s))
        ]
        wrong = sum(step.is_sure and not step.is_right for step in steps)
        right = sum(step.is_right for step in steps)
        texts.append(f"{stated_s} s stated: wrong {wrong}, right {right} of {len(steps)}")
    return "; ".join(texts)


def kidnapped(seeds: int) -> str:
    """An office, and a robot carried to a tag far away: right at the first step there."""
    found = []
    for seed in range(seeds):
        target = Simulation(world("office"), 1000 + seed).kidnap()
        x, y, _ = compose(np.array(target), np.array([1.5, 0.4, 0.0])).tolist()
        tag = Landmark(name="exit", x=x, y=y, sigma=0.05)
        tagged = replace(world("office"), landmarks=(tag,), observe=Camera().observe)
        simulation = Simulation(tagged, seed)
        mcl = ClusterMCL(tagged.map, landmarks=(tag,), seed=seed)
        before = list(run(tagged, seed, 100, knows_start=True, simulation=simulation, mcl=mcl))
        simulation.kidnap(target)
        after = next(run(tagged, seed, 30, simulation=simulation, mcl=mcl))
        found.append(before[-1].is_right and after.is_right)
    return f"{sum(found)} of {seeds}"


def cost(seeds: int) -> str:
    """20 landmarks in sight within 10 m: time for a cluster of 1,000 particles; once a step."""
    rng = np.random.default_rng(seeds)
    angles, distances = rng.uniform(0.0, math.tau, 20), 10.0 * np.sqrt(rng.random(20))
    places = np.stack([np.cos(angles), np.sin(angles)], axis=-1) * distances[:, None]
    marks = Landmarks(tuple(f"l{number}" for number in range(20)), places, np.full(20, 0.01))
    grid = Grid(np.zeros((400, 400), np.int8), 0.1, np.zeros(3))
    sighted = places + 0.1 * rng.normal(size=(20, 2))  # of a robot at the origin
    seen = [
        Sighting(at, np.eye(2) * 0.01, 0.05, landmark=name)
        for at, name in zip(sighted, marks.names, strict=True)
    ]
    poses, times = rng.normal(size=(1000, 3)) * (0.1, 0.1, 0.03), []
    for _ in range(1000):
        begin = time.perf_counter()
        arrays = ObservationArrays.of(seen, marks, grid)
        once = time.perf_counter()
        log_ratios(poses, arrays)
        times.append((time.perf_counter() - once, once - begin))
    cluster, step = 1e3 * np.median(times, axis=0)
    return f"{cluster:.3f} ms, and {step:.3f} ms for the arrays of the step"


ROWS: dict[str, Callable[[int], str]] = {
    row.__name__: row
    for row in (
        cross,
        false_names,
        moved_tag,
        gnss,
        reflectors,
        biased_fix,
        correlation,
        kidnapped,
        cost,
    )
}


def main(
    rows: Annotated[list[str] | None, typer.Argument(help="Rows; default: all.")] = None,
    seeds: Annotated[int, typer.Option(min=1, help="Runs of each row.")] = 20,
) -> None:
    """Print a line for each row."""
    for name in rows or ROWS:
        row = ROWS[name]
        print(f"{name}: {row.__doc__}\n    {row(seeds)}", flush=True)


if __name__ == "__main__":
    typer.run(main)
