"""One battery, one scorer, one table: are changes of the belief good for a robot?

    python -m benchmarks.referee [--small] [--rows NAME]... [--draw NAME] [--set KEY=VALUE]...

The folder of recordings is that of CLUSTERMCL_DATA. Each row is a kind of trial, such as "moved
20 %": robots of several buildings whose map has aged. Ordinary and augmented MCL with 2,000
particles have the same scans and the same given pose. With a cache their results are kept, because
only Cluster-MCL changes.

Where a pose is given, it is given after the first scan, 0.2 m and 0.08 rad off.
"""

import hashlib
import itertools
import math
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np
import typer

from benchmarks import aged_maps, off_map_robots, worlds
from benchmarks.aged_maps import Pieces
from benchmarks.experiments import mcl
from benchmarks.experiments.case import RecordedRobot
from benchmarks.experiments.catalogue import DATA_VARIABLE, recorded_cases
from benchmarks.people import CrowdSimulation
from clustermcl.belief.given_places import candidate, diagonal
from clustermcl.belief.outcome import BEFORE_FIRST_STEP, Outcome
from clustermcl.evaluation import run as runs
from clustermcl.evaluation.measures import LEAST_PROBABILITY, StepFacts, facts_of
from clustermcl.evaluation.run import course_of
from clustermcl.filter.arrays import FREE
from clustermcl.filter.poses import between, compose
from clustermcl.filter.random_streams import Purpose
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.warm_up import compile_kernels
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import pose_tuple
from clustermcl.protocol.steps import Scan, mirrored
from clustermcl.protocol.work import Place
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import BridgeSettings, Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.simulator.simulation import simulated_steps

STEPS, CHANGED_AT = 100, 60
WHOLE = 1_000_000
"""Steps of a recording, at most."""
GIVEN_OFF_M, GIVEN_OFF_RAD = 0.2, 0.08
GIVEN_SIGMA_M, GIVEN_SIGMA_RAD = 0.5, 0.26
"""As `set_pose` and nav2 have them."""
WRONG_BY_M = 5.0
KIDNAPPED_AT = 40
SPINNING_SHARE, SPUN_M = 0.04, 0.4
"""Share of the steps in which wheels spin, and the distance that odometry reports too much [m]."""
PARTICLES = 2_000
SHARE_OF_FURNITURE = 0.06

Role = Literal["training", "validation", "test"]
ROLES: dict[str, Role] = {
    "hall": "training", "intel": "training", "fr101": "training", "office": "validation",
    "wean-1": "training", "wean-2": "training", "wean-3": "training",
}  # fmt: skip
"""Buildings on which constants are chosen; all others are for test."""
ALGORITHMS = ("ours", "mcl", "amcl")

TrueSteps = list[tuple[Scan, PoseTuple | None]]
Begin = Literal["given", "nothing", "wrong"]


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One robot with one map."""

    row: str
    robot: str
    """A world, a recording, `split/NAME/PART`, `aged/NAME`, or a map file and the map to localize
    in."""
    number: int = 0
    """Seed of a simulated robot; of a recorded one where in the recording it begins, in tenths."""
    begin: Begin = "given"
    """Whether the pose is given after the first scan, or a wrong one, or none."""
    steps: int = STEPS
    change: str = ""
    """A key of `CHANGES`."""
    people: int = 0
    """Number of people who walk near a simulated robot."""
    on_map: bool = True
    scored_from: int = 1
    draw: str = ""
    """Other changes of the map, and another given pose, for each name."""

    @property
    def name(self) -> str:
        return f"{self.row}, {self.robot} {self.number}"

    @property
    def role(self) -> Role:
        return ROLES.get(self.robot, "test")

    @property
    def rng(self) -> np.random.Generator:
        """Random numbers that depend on the robot and the change, not on the filter."""
        named = f"{self.draw} {self.robot} {self.number} {self.change}".lstrip()
        digest = hashlib.sha256(named.encode()).digest()
        return np.random.default_rng(np.frombuffer(digest, np.uint32))


class Score(msgspec.Struct, frozen=True):
    """The figures of one run, as shares of the scored steps."""

    sure_right: float
    sure_wrong: float
    lost: float
    lost_right: float
    """Lost, though the best place is right."""
    localized: float
    tracked: bool
    """Whether some place is right at the last step."""
    log_score: float
    rmse_m: float | None
    """Of the best place, right or not; None without a truth."""


def score(facts: Sequence[StepFacts]) -> Score:
    """Return the figures of a run's scored steps."""
    claims = [each for each in facts if each.claims]
    errors = [each.error.distance_m for each in claims if each.error]
    return Score(
        sure_right=_share(each.confident and each.right for each in facts),
        sure_wrong=_share(each.confident and not each.right for each in facts),
        lost=_share(each.state == "lost" for each in facts),
        lost_right=_share(each.state == "lost" and each.right for each in facts),
        localized=_share(each.state == "localized" for each in facts),
        tracked=facts[-1].tracked,
        log_score=float(
            np.mean([math.log(max(f.truth_probability, LEAST_PROBABILITY)) for f in facts])
        ),
        rmse_m=math.sqrt(np.mean(np.square(errors))) if errors else None,
    )


def _share(flags: Iterable[bool]) -> float:
    return float(np.mean(list(flags)))


# --- the battery

CHANGES: dict[str, Callable[[GridMap, np.random.Generator], GridMap]] = {
    **{
        f"moved {share} %": lambda m, rng, share=share: aged_maps.with_pieces(
            m, Pieces(share=share / 100), rng
        )
        for share in (5, 10, 20, 40)
    },
    "missing": lambda m, rng: aged_maps.with_pieces(m, Pieces(share=0.2, painted=False), rng),
    "aside": lambda m, rng: aged_maps.with_pieces(
        m, Pieces(share=0.2, side_m=(1.5, 3.0), aside_m=(0.5, 0.5)), rng
    ),
    "gone": lambda m, rng: aged_maps.with_pieces(m, Pieces(share=0.2, removed=False), rng),
    "doors": lambda m, rng: aged_maps.with_closed_passages(m, (0.6, 1.3), 8, rng),
    "walls": lambda m, rng: aged_maps.with_closed_passages(m, (1.3, 4.0), 6, rng),
}
"""What the map has that the building has not, and the other way round."""
_FURNISHED = ("refurnished", "late refurnished")
_AGED = (("hall", 1), ("hall", 2), ("office", 1), ("office", 2), ("intel", 1), ("intel", 6),
         ("fr101", 0), ("aces", 1), ("aces", 5), ("fr079", 2), ("edmonton", 3),
         ("belgioioso", 4))  # fmt: skip
_AGED_SMALL = (("hall", 1), ("office", 2), ("intel", 1), ("aces", 5))
_CLEAR = ("aces", "belgioioso", "edmonton", "fhw", "fr079", "fr101", "intel")
_PLAIN = (*_CLEAR, "crob-jarvis", "wean-1", "wean-2", "wean-3")
_BEGINS: tuple[tuple[str, Begin], ...] = (("given", "given"), ("from nothing", "nothing"))
_LOGS = ("move10-hall-0", "move10-intel-0", "del20-hall-0", "del20-intel-0", "shift20-hall-0",
         "shift20-intel-0", "refurnish-hall-0", "refurnish-intel-0", "move20-hall-0",
         "move20-intel-0", "late-refurnish-hall-1")  # fmt: skip
_SPLIT = (("fhw", 4), ("fr079", 3), ("intel", 2))


def battery(*, small: bool) -> Iterator[Trial]:
    """Yield all trials."""
    yield from _in_aged_maps(small=small)
    yield from _in_other_maps(small=small)
    yield from _off_map(small=small)


def _in_aged_maps(*, small: bool) -> Iterator[Trial]:
    aged = _AGED_SMALL if small else _AGED
    for change in ("", *CHANGES, "refurnished"):
        for robot, number in aged:
            name = change or "true map"
            yield Trial(row=f"given, {name}", robot=robot, number=number, change=change)
    for change in ("", "moved 20 %", "refurnished"):
        for robot, number in aged:
            row = f"from nothing, {change or 'true map'}"
            yield Trial(row=row, robot=robot, number=number, change=change, begin="nothing")
    for robot, number in aged:
        yield Trial(
            row="late refurnished", robot=robot, number=number, change="late refurnished",
            steps=CHANGED_AT + STEPS, scored_from=CHANGED_AT,
        )  # fmt: skip
    for robot, number in aged:
        yield Trial(row="given wrongly", robot=robot, number=number, begin="wrong")


def _in_other_maps(*, small: bool) -> Iterator[Trial]:
    seeds = (1,) if small else (1, 2, 3, 4)
    for world, number in itertools.product(("hall", "office"), seeds):
        yield Trial(row="kidnapped", robot=world, number=number, change="kidnapped")
        yield Trial(
            row="given, moved 20 %, people", robot=world, number=number, change="moved 20 %",
            people=20,
        )  # fmt: skip
    for robot, number in _AGED_SMALL if small else _AGED:
        yield Trial(row="given, spinning wheels", robot=robot, number=number, change="spinning")
    for world in ("hall_symmetric", "cross"):
        yield Trial(row="symmetric", robot=world, number=1, begin="nothing")
    years = "gdc/f2_2019 in gdc/f2_2016"
    for (row, begin), number in itertools.product(_BEGINS, seeds):
        yield Trial(row=f"gdc, years, {row}", robot=years, number=number, begin=begin)
    for (row, begin), (name, parts) in itertools.product(_BEGINS, _SPLIT):
        for part in (parts - 1,) if small else range(parts):
            yield Trial(row=f"split, {row}", robot=f"split/{name}/part{part}", begin=begin)
    for (row, begin), name in itertools.product(_BEGINS, _LOGS[6:8] if small else _LOGS):
        yield Trial(row=f"aged logs, {row}", robot=f"aged/{name}", begin=begin, steps=160)
    for name in _PLAIN[:2] if small else _PLAIN:
        for change in ("", "moved 20 %", "moved 40 %", "refurnished"):
            row = f"given, whole recordings, {change or 'true map'}"
            yield Trial(row=row, robot=name, steps=WHOLE, change=change)


def _off_map(*, small: bool) -> Iterator[Trial]:
    """Yield robots that are nowhere on their maps."""
    for (row, begin), number in itertools.product(_BEGINS, (1,) if small else (1, 2, 3, 4)):
        floors, name = "gdc/f3 in gdc/f4", f"gdc, floors, {row}"
        yield Trial(row=name, robot=floors, number=number, begin=begin, on_map=False)
    for name in _CLEAR[:2] if small else _CLEAR:
        for number in (0,) if small else (0, 3, 6):
            yield Trial(
                row="mirrored", robot=name, number=number, begin="nothing", change="mirrored",
                on_map=False,
            )  # fmt: skip
    for robot, place in off_map_robots.FOREIGN[:2] if small else off_map_robots.FOREIGN:
        yield Trial(row="foreign", robot=f"{robot} in {place}", begin="nothing", on_map=False)
    for world, number in (("hall", 1),) if small else itertools.product(("hall", "office"), (1, 2)):
        yield Trial(
            row="half", robot=world, number=number, begin="nothing", change="half", on_map=False
        )


def begun(trial: Trial, data: Path | None) -> tuple[GridMap, TrueSteps]:
    """Return the map that the localizer gets, and the steps."""
    grid_map, steps = _robot(trial, data)
    change, rng = trial.change, trial.rng
    if change in CHANGES:
        grid_map = CHANGES[change](grid_map, rng)
    elif change in _FURNISHED:
        path = [truth for _, truth in steps if truth is not None]
        old, new = (aged_maps.furniture(grid_map, SHARE_OF_FURNITURE, path, rng) for _ in range(2))
        late = CHANGED_AT if change != "refurnished" else 0
        first = aged_maps.seen_with_furniture(steps[:late], grid_map, old, rng)
        steps = [*first, *aged_maps.seen_with_furniture(steps[late:], grid_map, new, rng)]
        grid_map = aged_maps.with_furniture(grid_map, old)
    elif change == "mirrored":
        steps = [(mirrored(scan), None) for scan, _ in steps]
    elif change == "spinning":
        steps = with_spinning_wheels(steps, rng)
    return grid_map, steps


def _robot(trial: Trial, data: Path | None) -> tuple[GridMap, TrueSteps]:
    """Return the robot's own map, or the one it is localized in, and the steps."""
    robot, _, place = trial.robot.partition(" in ")
    if robot.startswith("gdc/"):
        assert data is not None
        simulated = runs.SimulatedRobot(
            world=str(data / f"{robot}.yaml"), map=data / f"{place}.yaml"
        )
        case = runs.Case(robot=simulated, updates=trial.steps)
        made = course_of(case, trial.number, BridgeSettings())
        return made.map, list(made.steps)
    if robot.startswith(("split/", "aged/")):
        assert data is not None
        part = data / robot
        recorded = RecordedRobot(
            recording=part.with_name(f"{part.name}.log.gz"),
            map=part.with_name("map.yaml") if "split/" in robot else part.with_suffix(".yaml"),
            reference=part.with_suffix(".tum"),
        )
        return recorded_steps(runs.Case(robot=recorded), 0.0, trial.steps)
    cases = {case.name: case for case in recorded_cases(data)}
    if robot in cases:
        grid_map, steps = recorded_steps(cases[robot], trial.number / 10, trial.steps)
        if place:
            assert isinstance(cases[place].robot, RecordedRobot)
            return load_map(cases[place].robot.map), [(scan, None) for scan, _ in steps]
        return grid_map, steps
    world = worlds.world(robot)
    start = (
        off_map_robots.start_in_right(world.map, trial.number) if trial.change == "half" else None
    )
    simulation = CrowdSimulation(world, trial.number, trial.people, start=start)
    steps = []
    for step in simulated_steps(simulation, BridgeSettings()):
        steps.append(step)
        if len(steps) == trial.steps:
            break
        if trial.change == "kidnapped" and len(steps) == KIDNAPPED_AT:
            simulation.kidnap()
    grid_map = off_map_robots.without_right(world.map) if trial.change == "half" else world.map
    return grid_map, steps


def with_spinning_wheels(steps: TrueSteps, rng: np.random.Generator) -> TrueSteps:
    """Return steps of a robot whose wheels spin now and then: odometry reports a drive."""
    turned = []
    spun = last = np.zeros(3)
    for scan, truth in steps:
        now = np.array(scan.odom_from_robot)
        spun, last = compose(spun, between(last, now)), now
        if rng.random() < SPINNING_SHARE:
            spun = compose(spun, np.array([SPUN_M, 0.0, 0.0]))
        turned.append((msgspec.structs.replace(scan, odom_from_robot=pose_tuple(spun)), truth))
    return turned


@cache
def _all_steps(case: runs.Case) -> tuple[GridMap, TrueSteps]:
    made = course_of(case, 0, BridgeSettings())
    return made.map, [(scan, truth) for scan, truth in made.steps if truth is not None]


def recorded_steps(case: runs.Case, from_share: float, count: int) -> tuple[GridMap, TrueSteps]:
    """Return some steps of a recording that have a true pose, from a share of its steps on."""
    grid_map, steps = _all_steps(case)
    first = min(round(from_share * len(steps)), max(len(steps) - count, 0))
    return grid_map, steps[first : first + count]


# --- runs


def given_place(trial: Trial, grid_map: GridMap, scan: Scan, truth: PoseTuple) -> Place:
    """Return the place that a person gives, after a scan."""
    rng = trial.rng
    bearing, side = rng.uniform(0.0, 2.0 * math.pi), rng.choice((-1.0, 1.0))
    x, y = (truth[i] + GIVEN_OFF_M * part(bearing) for i, part in enumerate((math.cos, math.sin)))
    pose = (x, y, truth[2] + GIVEN_OFF_RAD * float(side))
    while trial.begin == "wrong" and math.dist(pose[:2], truth[:2]) < WRONG_BY_M:
        row, col = rng.choice(np.argwhere(grid_map.cells == FREE)) + 0.5
        assert grid_map.map_from_grid[2] == 0.0
        x, y = (grid_map.map_from_grid[i] + n * grid_map.cell_m for i, n in enumerate((col, row)))
        pose = (float(x), float(y), float(rng.uniform(-math.pi, math.pi)))
    return candidate(
        Settings().belief.set_pose_probability,
        pose,
        diagonal(GIVEN_SIGMA_M, GIVEN_SIGMA_RAD),
        seed=trial.number,
        purpose=Purpose.GIVEN_POSE,
        entity=1,
        step=scan.step,
        odom_from_robot=scan.odom_from_robot,
    )


def outcomes(
    trial: Trial, algorithm: str, settings: Settings, data: Path | None
) -> Iterator[tuple[Outcome, PoseTuple | None]]:
    """Yield the belief after each step, and the true pose."""
    grid_map, steps = begun(trial, data)
    model = sensor_model(grid_map, settings.sensor, kept_folder("maps"))
    settings = msgspec.structs.replace(settings, seed=trial.number)
    process: InProcess | mcl.OrdinaryMCL
    if algorithm == "ours":
        process = InProcess(model, settings)
    else:
        process = mcl.OrdinaryMCL(
            model, settings, mcl.AMCL_GAINS if algorithm == "amcl" else None, PARTICLES
        )
    for index, (scan, truth) in enumerate(steps):
        is_given = index == 0 and trial.begin != "nothing"
        if isinstance(process, InProcess):
            outcome = process.advance(scan)
            if is_given:
                outcome = process.ensemble.set_pose(given_place(trial, grid_map, scan, truth))
                process.carry_out(outcome)
        elif is_given:  # the first scan, which is not scored, would find a place for nothing
            process.set_pose(given_place(trial, grid_map, scan, truth))
            outcome = BEFORE_FIRST_STEP
        else:
            outcome = process.advance(scan)
        yield outcome, truth if trial.on_map else None


def run(trial: Trial, algorithm: str, settings: Settings, data: Path | None) -> Score:
    """Localize a robot, and return its figures."""
    facts = [
        facts_of(index, 0, outcome, truth)
        for index, (outcome, truth) in enumerate(outcomes(trial, algorithm, settings, data))
    ]
    return score(facts[trial.scored_from :])


def _kept(trial: Trial, algorithm: str, folder: Path | None) -> Path | None:
    """Return the file in which a baseline's figures are kept."""
    if folder is None or algorithm == "ours":
        return None
    named = hashlib.sha256(repr(trial).encode()).hexdigest()[:16]
    return folder / f"{algorithm}-{named}.json"


def run_or_read(
    trial: Trial, algorithm: str, chosen: Sequence[str], data: Path | None, folder: Path | None
) -> Score:
    """Return the figures of a run, or what an earlier run of a baseline has written."""
    kept = _kept(trial, algorithm, folder)
    if kept is not None and kept.is_file():
        return msgspec.json.decode(kept.read_bytes(), type=Score)
    made = run(trial, algorithm, load_settings(None, chosen), data)
    if kept is not None:
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_bytes(msgspec.json.encode(made))
    return made


# --- the table


def row_of(scores: Sequence[Score], *, on_map: bool) -> str:
    """Return the figures of one algorithm in one row, in percent."""
    if not scores:
        return "| |"
    if not on_map:
        called = [100.0 * each.localized for each in scores]
        lost = 100.0 * np.mean([each.lost for each in scores])
        return f" localized {np.mean(called):.1f}, worst {max(called):.0f}; lost {lost:.0f} |"
    sr, sw, lost, lost_right = (
        100.0 * np.mean([getattr(each, name) for each in scores])
        for name in ("sure_right", "sure_wrong", "lost", "lost_right")
    )
    tracked = sum(each.tracked for each in scores)
    rmse = np.mean([each.rmse_m or math.nan for each in scores])
    text = f"**{sr:.1f}** / {sw:.1f} / {lost:.1f} ({lost_right:.1f})"
    log_score = np.mean([each.log_score for each in scores])
    return f" {text}, {tracked} of {len(scores)}, {log_score:.2f}, {rmse:.2f} m |"


def main(
    *,
    small: bool = False,
    rows: Annotated[list[str], typer.Option(help="Part of a row's name and its robot.")] = [],  # noqa: B006
    draw: Annotated[str, typer.Option(help="Draw other changes of the maps.")] = "",
    algorithms: str = ",".join(ALGORITHMS),
    chosen: Annotated[list[str], typer.Option("--set", metavar="KEY=VALUE")] = [],  # noqa: B006
    cache_folder: Annotated[Path | None, typer.Option("--cache")] = None,
    jobs: int = 1,
    each: Annotated[bool, typer.Option(help="Print every run, too.")] = False,
) -> None:
    """Print a Markdown table: sr / sw / lost (right), tracked at the end, log score, RMSE."""
    named = os.environ.get(DATA_VARIABLE)
    data = Path(named) if named else None
    drawn = (replace(trial, draw=draw) for trial in battery(small=small))
    trials = [t for t in drawn if not rows or any(name in t.name for name in rows)]
    names = algorithms.split(",")
    tasks = list(itertools.product(trials, names))
    found: dict[tuple[str, str], list[Score]] = {}
    compile_kernels(load_settings(None, chosen).sensor)
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [pool.submit(run_or_read, t, a, chosen, data, cache_folder) for t, a in tasks]
        print(f"| row | {' | '.join(names)} |\n|{' --- |' * (1 + len(names))}", flush=True)
        for index, ((trial, name), future) in enumerate(zip(tasks, waiting, strict=True)):
            made = future.result()
            found.setdefault((trial.row, name), []).append(made)
            if each:
                text = row_of([made], on_map=trial.on_map)
                print(
                    f"    {trial.name} ({trial.role}) {name}: {text}", file=sys.stderr, flush=True
                )
            if index + 1 == len(tasks) or tasks[index + 1][0].row not in {trial.row}:
                _print_row(trial, names, found)


def _print_row(
    trial: Trial, names: Sequence[str], found: dict[tuple[str, str], list[Score]]
) -> None:
    cells = [row_of(found.get((trial.row, name), ()), on_map=trial.on_map) for name in names]
    print(f"| {trial.row} |{''.join(cells)}", flush=True)


if __name__ == "__main__":
    typer.run(main)
