"""One battery, one scorer, one table: are changes of the belief good for a robot?

    python -m benchmarks.referee [--small] [--maps] [--rows NAME]... [--draw NAME]

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
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer

from benchmarks.experiments import mcl
from benchmarks.experiments.catalogue import DATA_VARIABLE
from benchmarks.referee_robots import Trial, battery, begun, in_maps
from clustermcl.belief.given_places import candidate, diagonal
from clustermcl.belief.outcome import BEFORE_FIRST_STEP, Outcome
from clustermcl.evaluation.measures import LEAST_PROBABILITY, StepFacts, facts_of
from clustermcl.filter.arrays import FREE
from clustermcl.filter.random_streams import Purpose
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.jobs.warm_up import compile_kernels
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.protocol.work import Place
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings

GIVEN_OFF_M, GIVEN_OFF_RAD = 0.2, 0.08
GIVEN_SIGMA_M, GIVEN_SIGMA_RAD = 0.5, 0.26
"""As `set_pose` and nav2 have them."""
WRONG_BY_M = 5.0
PARTICLES = 2_000
ALGORITHMS = ("ours", "mcl", "amcl")


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
    maps: Annotated[bool, typer.Option(help="Only robots in buildings known by a map.")] = False,
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
    drawn = (replace(trial, draw=draw) for trial in (in_maps if maps else battery)(small=small))
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
