"""`clustermcl evaluate`: localizes in one process, repeatedly, and measures the accuracy."""

import csv
import io
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import msgspec
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from clustermcl.belief.outcome import Outcome
from clustermcl.commands import options as opt
from clustermcl.commands.kernels import prepare_kernels
from clustermcl.evaluation.measures import RunMeasures, StepFacts, facts_of, measures_of
from clustermcl.evaluation.references import tum_line
from clustermcl.evaluation.run import Case, RecordedRobot, Run, SimulatedRobot, in_parallel
from clustermcl.protocol.errors import SettingsError
from clustermcl.recordings.maps.map_file import map_file_of
from clustermcl.runtime.logs import is_quiet
from clustermcl.runtime.output_files import check_output_file, write_output_file
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.sources import NEED_MAP, Simulated, parsed_source
from clustermcl.runtime.stop import StopFlag, StoppedError, stop_on_signals
from clustermcl.sensor_bridge.recorded import opened
from clustermcl.view import plots

MOST_RUNS, MOST_JOBS = 10_000, 256
"""Limits against typing errors."""
MOST_STEPS = 100_000
"""Limit for an evaluated run, 20 km of driving: all measurements are kept in memory."""
DEFAULT_STEPS = 300
"""Default number of steps of a simulated robot, which drives until it is stopped."""
DEFAULT_STEPS_OF_A_START = 60

Result = dict[str, Any]
"""One run: `seed`, `start_step` (of the recording) and the fields of `RunMeasures`."""
Columns = dict[str, tuple[str, str]]
"""The columns of a table: heading, and the key and the format of a run's measure."""
_SEED = {"seed": ("seed", "d"), "start": ("start_step", "d")}
_POSES: Columns = {
    **_SEED,
    "right from": ("localized_at_step", "d"),
    "after s": ("localized_at_s", ".1f"),
    "final m": ("final_error_m", ".2f"),
    "final rad": ("final_error_rad", ".3f"),
    "rmse m": ("rmse_m", ".3f"),
    "sure, wrong": ("confidently_wrong_fraction", ".3f"),
    "log score": ("log_score_mean", ".2f"),
    "steps": ("steps", "d"),
    "wall s": ("wall_s", ".1f"),
    "cpu s": ("cpu_s", ".1f"),
}
_STATES: Columns = {
    **_SEED,
    "localized": ("localized_fraction", ".3f"),
    "ambiguous": ("ambiguous_fraction", ".3f"),
    "lost": ("lost_fraction", ".3f"),
    "searching": ("searching_fraction", ".3f"),
    "p(elsewhere)": ("elsewhere_probability_mean", ".2f"),
    "p(off map)": ("off_map_probability_mean", ".2f"),
}

_log = logging.getLogger(__name__)


def executed(
    run: Run, on_update: Callable[[Outcome, StepFacts], None] = lambda _outcome, _facts: None
) -> RunMeasures:
    _, steps = run.begun()
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    facts: list[StepFacts] = []
    for number, (scan, outcome, truth) in enumerate(steps):
        facts.append(facts_of(number, scan.stamp_ns, outcome, truth))
        on_update(outcome, facts[-1])
    return measures_of(
        facts, wall_s=time.perf_counter() - wall_s, cpu_s=time.process_time() - cpu_s
    )


@opt.recording_command
def evaluate(
    settings: Settings,
    recording: Annotated[str, opt.argument("RECORDING", "Recording, sim:WORLD or sim:MAP.yaml.")],
    map_file: opt.MapOfRecording = None,
    reference: Annotated[Path | None, opt.option("Ground truth.", "FILE.tum")] = None,
    seeds: Annotated[
        int, opt.option("Number of runs; the first has the seed set.", min=1, max=MOST_RUNS)
    ] = 1,
    starts: Annotated[
        int | None,
        opt.option("Number of runs from different steps of a recording.", min=1, max=MOST_RUNS),
    ] = None,
    steps: Annotated[
        int | None,
        opt.option("Most steps: 300 if simulated, 60 with --starts.", min=1, max=MOST_STEPS),
    ] = None,
    jobs: Annotated[
        int | None, opt.option("Parallel runs; by default one per core.", min=1, max=MOST_JOBS)
    ] = None,
    as_json: opt.AsJson = False,
    output: Annotated[Path | None, opt.option("Write a row for each run.", "FILE.csv")] = None,
    tum: Annotated[Path | None, opt.option("Write the estimates for evo.", "FILE.tum")] = None,
    plot: Annotated[
        Path | None, opt.option("Draw one run: path, probability, error.", "FILE.png")
    ] = None,
    floor: opt.Floor = "",
) -> None:
    """Localize in one process, and measure the accuracy.

    Runs without Zenoh, as fast as possible.
    """
    robot = msgspec.structs.replace(robot_of(recording, map_file, reference), floor=floor)
    simulated = isinstance(robot, SimulatedRobot)
    if simulated and starts:
        raise SettingsError("--starts: a simulated robot starts elsewhere with each seed: --seeds")
    usual = DEFAULT_STEPS if simulated else DEFAULT_STEPS_OF_A_START if starts else None
    case = Case(robot=robot, updates=steps or usual)
    needed = ("--map", map_file) if simulated else ("--reference", reference)
    opt.refuse_without(*needed, floor=floor)
    _check_files({"--output": output, "--tum": tum, "--plot": plot}, max(seeds, starts or 1))
    figure = None if plot is None else plots.new_figure((3.0, 1.0))  # raises without matplotlib
    if isinstance(robot, SimulatedRobot) and robot.map and str(robot.map) != robot.world:
        _log.warning("the robot drives in %s, and is given the map %s", robot.world, robot.map)
    if isinstance(robot, RecordedRobot):
        opened(recording, settings.bridge)  # reports the skipped lines, once
    runs = [
        Run(case=case, seed=seed, settings=settings)
        for seed in range(settings.seed, settings.seed + seeds)
    ]
    known = _steps_count(runs[0])  # raises input errors before any process is started
    if starts is not None:
        at = start_steps(known, starts, case.updates or known)
        runs = [replace(run, start_step=start) for start in at for run in runs]
    prepare_kernels(settings.sensor)
    stop, course = stop_on_signals(exit_after_s=5.0), list[plots.Drawn]()
    finished = _all_results(runs, jobs, min(known, case.updates or known), stop, course)
    results = [
        {"seed": run.seed, "start_step": run.start_step, **msgspec.structs.asdict(measures)}
        for run, measures in zip(runs, finished, strict=True)
        if measures is not None
    ]
    if len(results) < len(runs) > 1:
        _log.warning("interrupted: %d of %d runs are finished", len(results), len(runs))
    if not results:
        stop.check()
    common = {"recording": recording, "map": map_file}
    if output is not None:
        _write_results(output, common, results)
    if tum is not None:
        write_output_file(tum, "".join(tum_line(step.stamp_ns, step.pose) for step in course))
    if plot is not None and course:
        plots.draw_run(figure, runs[0].begun()[0].map, course)
        plots.save(figure, plot)
    if as_json:
        sys.stdout.write(json.dumps({**common, "runs": results}, indent=2) + "\n")
    else:
        states = "share of the steps in each state"
        _print_tables({_title(recording, results): _POSES, states: _STATES}, results)
    stop.check()


def _check_files(files: Mapping[str, Path | None], runs: int) -> None:
    for option, ending in (("--output", ".csv"), ("--tum", ".tum"), ("--plot", ".png")):
        if (file := files[option]) is None:
            continue
        if runs > 1 and option != "--output":
            problem = "a file has one run; leave out --seeds and --starts"
            raise SettingsError(f"{option} {file}: {problem}")
        check_output_file(file, ending)


def _print_tables(tables: dict[str, Columns], runs: Sequence[Result]) -> None:
    console = Console(emoji=False, markup=False, highlight=False)  # "sim:office:" is not an emoji
    for heading, columns in tables.items():
        console.print(heading, soft_wrap=True)
        table = Table(*columns, box=None, padding=(0, 1, 0, 0), header_style="bold")
        rows = [
            ["-" if run[key] is None else format(run[key], form) for key, form in columns.values()]
            for run in runs
        ]
        for column, cells in zip(table.columns, zip(*rows, strict=True), strict=True):
            words = [*str(column.header).split(), *cells]
            column.justify, column.min_width = "right", max(map(len, words))  # headings fold
        for row in rows:
            table.add_row(*row)
        console.print(table)


def _write_results(file: Path, common: Result, runs: Sequence[Result]) -> None:
    text = io.StringIO()
    table = csv.DictWriter(text, [*common, *runs[0]], lineterminator="\n")
    table.writeheader()
    table.writerows({**common, **run} for run in runs)
    write_output_file(file, text.getvalue())


def _title(recording: str, runs: Sequence[Result]) -> str:
    if all(run["log_score_mean"] is None for run in runs):
        return f"{recording}: errors unknown without true poses (--reference)"
    return f"{recording}: localized in {sum(run['localized'] for run in runs)} of {len(runs)}"


def start_steps(steps: int, starts: int, steps_each: int) -> tuple[int, ...]:
    """Return start steps of runs, evenly from 0 to the last from which a full run fits.

    Raises:
        SettingsError: the recording is too short for this number of starts.
    """
    last = max(steps - steps_each, 0)
    if starts > last + 1:
        allowed = f"{last + 1} starts of {steps_each} steps"
        raise SettingsError(f"--starts {starts}: {steps} steps allow {allowed}")
    return tuple(round(index * last / max(starts - 1, 1)) for index in range(starts))


def robot_of(
    recording: str, map_file: str | None, reference: Path | None
) -> SimulatedRobot | RecordedRobot:
    """Return the robot that the options name; refuse contradictions."""
    named = map_file_of(map_file or "", recording)
    file = Path(named) if named else None
    source = parsed_source(recording)
    if isinstance(source, Simulated):
        if reference:
            raise SettingsError("--reference: a simulated robot knows where it is; leave it out")
        return SimulatedRobot(world=source.world, map=file)
    if file is None:
        raise SettingsError(NEED_MAP)
    return RecordedRobot(recording=Path(recording), map=file, reference=reference)


def _steps_count(run: Run) -> int:
    """Return the number of steps of the robot; opens all inputs, which checks them."""
    if isinstance(run.case.robot, SimulatedRobot):
        next(run.begun()[0].steps)
        return run.case.updates or DEFAULT_STEPS
    whole = replace(run, case=msgspec.structs.replace(run.case, updates=None))
    return sum(1 for _ in whole.begun()[0].steps)


def _all_results(
    runs: Sequence[Run], jobs: int | None, steps: int, stop: StopFlag, course: list[plots.Drawn]
) -> list[RunMeasures | None]:
    """Execute the runs, in parallel if there are several, and return the measures of each.

    Those that the stop flag ended have none. Of one run, `course` gets the estimates.
    """
    done: dict[int, RunMeasures] = {}
    console = Console(stderr=True, emoji=False)
    hidden = is_quiet() or not console.is_terminal
    with Progress(console=console, transient=True, disable=hidden) as progress:
        bar = progress.add_task("steps", total=steps * len(runs))

        def on_update(outcome: Outcome, facts: StepFacts) -> None:
            stop.check()
            progress.advance(bar)
            error_m = facts.error.distance_m if facts.error else None
            course.extend(
                plots.Drawn(facts.stamp_ns, best.pose, best.probability, error_m)
                for best in outcome.hypotheses[:1]
            )

        if len(runs) == 1:
            with suppress(StoppedError):
                done[0] = executed(runs[0], on_update)
        else:
            for index, finished in in_parallel(executed, runs, jobs or os.cpu_count() or 1, stop):
                progress.advance(bar, finished.steps)
                done[index] = finished
                _log.info("%d of %d runs are finished", len(done), len(runs))
    return [done.get(index) for index in range(len(runs))]
