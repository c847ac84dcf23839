"""Measures what the belief and one particle set conclude from views that repeat.

    python -m benchmarks.same_views [--seeds N] [--only NAME] [--set KEY=VALUE]

The worlds are a hall with two-fold symmetry whose map lacks one block, and a corridor in which no
scan shows the position. The robot turns on the spot, or drives back and forth.
"""

import argparse
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import msgspec
import numpy as np

from clustermcl.belief.given_places import candidate
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.measures import CONFIDENT_PROBABILITY, pose_error
from clustermcl.filter.poses import heading_distance
from clustermcl.filter.random_streams import Purpose
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import covariance_matrix
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Place
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.simulation import Simulation
from clustermcl.simulator.worlds.halls import hall_symmetric
from clustermcl.simulator.worlds.office import office
from clustermcl.simulator.worlds.world import Canvas, World

Drive = Callable[[float], tuple[float, float]]
"""Speed [m/s] and turn rate [rad/s] at a time [s]."""


_BLOCK = (8.0, -2.4, 9.2, -0.8)


def block_gone() -> World:
    """A symmetric hall with two blocks; the map lacks the one next to the robot."""
    blocks, real, mapped = (Canvas(30.0, 22.0) for _ in range(3))
    blocks.block(*_BLOCK)
    blocks.repeat_turned(2)
    real.cells[:] = hall_symmetric().map.cells
    real.add(blocks)
    mapped.cells[:] = real.cells
    mapped.floor(*_BLOCK)
    return World(
        map=mapped.grid_map(),
        truth=real.grid_map(),
        start=(1.0, 0.0, math.pi),
    )


def corridor(length_m: float = 200.0) -> World:
    """Two walls, and one cabinet in front of the robot, which was moved by a metre."""
    mapped, real = (Canvas(length_m + 4.0, 8.0) for _ in range(2))
    for plan, x in ((mapped, 4.0), (real, 5.0)):
        plan.floor(-length_m / 2, -1.2, length_m / 2, 1.2)
        plan.add_walls()
        plan.block(x, 0.7, x + 0.6, 1.2)
        plan.block(-7.0, -1.2, -6.4, -0.7)
    return World(
        map=mapped.grid_map(),
        truth=real.grid_map(),
        start=(0.0, 0.0, 0.0),
    )


def turning(_: float) -> tuple[float, float]:
    """On the spot."""
    return 0.0, 1.0


def pacing(seconds: float) -> tuple[float, float]:
    """Two metres forth and back again, by turning round."""
    phase = seconds % 16.0
    return (0.5, 0.0) if phase < 4.0 or 8.0 <= phase < 12.0 else (0.0, math.pi / 4.0)


def standing(_: float) -> tuple[float, float]:
    """Not at all."""
    return 0.0, 0.0


@dataclass(frozen=True, kw_only=True)
class Case:
    """One robot."""

    world: Callable[[], World]
    drive: Drive
    steps: int
    given_m: float = 0.0
    """The start is given, with this standard deviation along it; 0: the robot searches."""
    settings: tuple[str, ...] = ()


CASES = {
    "turn": Case(world=block_gone, drive=turning, steps=400),
    "pace": Case(world=block_gone, drive=pacing, steps=400),
    "corridor": Case(world=corridor, drive=turning, steps=120, given_m=0.8),
    "stand": Case(
        world=office,
        drive=standing,
        steps=600,
        settings=("bridge.gate_distance_m=0", "bridge.gate_turn_rad=0"),
    ),
}


def steps_of(case: Case, seed: int, settings: Settings) -> Iterator[tuple[Scan, PoseTuple]]:
    """Steps with the true poses."""
    world = case.world()
    simulation = Simulation(world, seed)
    maker = StepMaker(settings.bridge, map_digest="", sender="benchmark")
    for tick in simulation:
        simulation.robot.drive_at(*case.drive(tick.laser.stamp_ns * 1e-9))
        for reading in tick.readings:
            scan = maker.on_reading(reading)
            if scan is not None:
                yield scan, tick.map_from_robot


@dataclass(frozen=True)
class Answer:
    """One step's answer."""

    truth: float
    """Probability of places that are right."""
    best: float
    is_right: bool
    error_m: float
    sds: float
    """Error of the best place in its own standard deviations."""
    state: str


def answer_of(outcome: Outcome, truth: PoseTuple) -> Answer:
    """Accuracy of a belief with known ground truth."""
    if not outcome.hypotheses:
        return Answer(0.0, 0.0, False, math.nan, math.nan, outcome.state)
    right = [pose_error(each.pose, truth).right for each in outcome.hypotheses]
    first = outcome.hypotheses[0]
    off = np.array(first.pose) - np.array(truth)
    off[2] = heading_distance(first.pose[2], truth[2])
    covariance = covariance_matrix(first.covariance)[:2, :2] + np.eye(2) * 1e-6
    sds = math.sqrt(off[:2] @ np.linalg.solve(covariance, off[:2]))
    probabilities = [each.probability for each in outcome.hypotheses]
    held = math.fsum(p for p, is_right in zip(probabilities, right, strict=True) if is_right)
    return Answer(held, first.probability, right[0], math.hypot(*off[:2]), sds, outcome.state)


def given_place(sigma_m: float, truth: PoseTuple, scan: Scan, seed: int) -> Place:
    """The true place, uncertain along x."""
    spread = (sigma_m**2, 0.0, 0.0, 0.0, 0.05**2, 0.0, 0.0, 0.0, 0.05**2)
    return candidate(
        1.0,
        truth,
        spread,
        seed=seed,
        purpose=Purpose.START,
        entity=0,
        step=scan.step,
        odom_from_robot=scan.odom_from_robot,
    )


def run(case: Case, seed: int, settings: Settings) -> list[Answer]:
    """Reported values of each step."""
    model = sensor_model(case.world().map, settings.sensor, cache_folder=None)
    process = InProcess(model, msgspec.structs.replace(settings, seed=seed))
    answers = []
    for scan, truth in steps_of(case, seed, settings):
        outcome = process.advance(scan)
        if case.given_m and not answers:
            place = given_place(case.given_m, truth, scan, seed)
            process.carry_out(process.ensemble.continue_from([place], scan.step, "forgotten"))
        answers.append(answer_of(outcome, truth))
        if len(answers) == case.steps:
            return answers
    return answers


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--only", choices=CASES)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    options = parser.parse_args()
    columns = "robot|seed|P(truth) after 50, 100, all|sure and wrong|lost|beyond 5 sd|error [m]"
    print(f"| {columns.replace('|', ' | ')} |\n|{' --- |' * 7}")
    for name, case in CASES.items():
        if options.only not in (None, name):
            continue
        settings = load_settings(None, [*case.settings, *options.set])
        for seed in range(options.seeds):
            answers = run(case, seed, settings)
            wrong = sum(a.best >= CONFIDENT_PROBABILITY and not a.is_right for a in answers)
            lost = sum(a.state == "lost" for a in answers)
            beyond = sum(a.sds > 5.0 and a.error_m < 6.0 for a in answers)
            truths = ", ".join(f"{answers[i].truth:.3f}" for i in (50, 100, -1))
            error = np.nanmean([a.error_m for a in answers if a.error_m < 6.0] or [math.nan])
            print(f"| {name} | {seed} | {truths} | {wrong} | {lost} | {beyond} | {error:.3f} |")


if __name__ == "__main__":
    main()
