"""`clustermcl evaluate`: localizes in one process, repeatedly, and measures the accuracy.

It runs without Zenoh, as fast as possible.
"""

import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from coordinator.belief.outcome import belief_after
from evaluation.course import Case, RecordedRobot, SimulatedRobot
from evaluation.measures import RunMeasures, StepFacts, facts_of, measures_of
from evaluation.references import written_trajectory
from evaluation.results import MORE_TABLES, POSES, Columns, Result, table_rows, write_results
from evaluation.run import Run, in_parallel
from process_runtime.logs import is_quiet
from process_runtime.output_files import check_output_file
from process_runtime.settings import Settings
from process_runtime.sources import Simulated, parsed_source
from process_runtime.stop import stop_on_signals
from protocol.errors import SettingsError
from recordings.map_file import map_file_of
from recordings.run_log import RunLog
from sensor_bridge.recorded import opened

DEFAULT_STEPS = 300
"""Default number of steps of a simulated robot, which drives until it is stopped."""
DEFAULT_STEPS_OF_A_START = 60


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """Options of `clustermcl evaluate`."""

    recording: str
    map_file: str | None = None
    reference: Path | None = None
    seeds: int = 1
    starts: int | None = None
    """Number of runs: of a recording, from start steps spread evenly; of a simulated robot, with
    different seeds."""
    steps: int | None = None
    kidnap_at: int | None = None
    jobs: int | None = None
    as_json: bool = False
    """Print JSON instead of tables."""
    output: Path | None = None
    """CSV file for the results; None: write no file."""
    record: Path | None = None
    """File for the recording of a single run; None: write no file."""
    tum: Path | None = None
    """File for the estimated trajectory of a single run; None: write no file."""


def executed(
    options: EvaluateOptions, run: Run, on_update: Callable[[], None] | None = None
) -> RunMeasures:
    """Execute a run, and write its files."""
    course, steps = run.begun()
    wall_s, cpu_s = time.perf_counter(), time.process_time()
    facts: list[StepFacts] = []
    recording = RunLog.to(options.record) if options.record else nullcontext()
    with recording as recorder, written_trajectory(options.tum) as on_pose:
        for number, (scan, outcome, truth) in enumerate(steps):
            facts.append(facts_of(number, scan.stamp_ns, outcome, truth))
            if recorder is not None:
                if recorder.wants_map(scan):
                    recorder.on_map(course.map, scan.stamp_ns)
                recorder.on_scan(scan)
                recorder.on_belief(belief_after(scan, outcome, scan.sender))
            if outcome.hypotheses:
                on_pose(scan.stamp_ns, outcome.hypotheses[0].pose)
            if on_update is not None:
                on_update()
            if number == options.kidnap_at:
                course.kidnap()
    return measures_of(
        facts, wall_s=time.perf_counter() - wall_s, cpu_s=time.process_time() - cpu_s
    )


def run_evaluate(options: EvaluateOptions, settings: Settings) -> None:
    """Execute all runs, print tables or JSON, and write the requested files.

    Raises:
        ClusterMclError: an input cannot be used, or a run failed.
        StoppedError: interrupted.
    """
    case, seeds = case_of(options)
    if options.output is not None:
        if options.output.suffix.lower() != ".csv":
            problem = f"--output {options.output}: must end in .csv; --json prints JSON"
            raise SettingsError(key="--output", problem=problem)
        check_output_file(options.output)
    if isinstance(case.robot, RecordedRobot):
        opened(options.recording, settings.bridge)  # reports the skipped lines, once
    runs = [
        Run(case=case, seed=seed, settings=settings)
        for seed in range(settings.seed, settings.seed + seeds)
    ]
    steps = _steps_count(runs[0])  # raises input errors before any process is started
    if options.starts is not None and isinstance(case.robot, RecordedRobot):
        starts = start_steps(steps, options.starts, case.updates or steps)
        runs = [replace(run, start_step=start) for start in starts for run in runs]
    for option, file in {"--record": options.record, "--tum": options.tum}.items():
        if file is not None and len(runs) > 1:
            problem = f"{option} needs a single run: leave out --seeds and --starts"
            raise SettingsError(key=option, problem=problem)
        if file is not None:
            check_output_file(file)
    finished = _all_results(options, runs, min(steps, case.updates or steps))
    results = [
        {"seed": run.seed, "start_step": run.start_step, **msgspec.structs.asdict(measures)}
        for run, measures in zip(runs, finished, strict=True)
    ]
    common = {
        "recording": options.recording,
        "map": options.map_file,
    }
    if options.output is not None:
        write_results(options.output, common, results)
    if options.as_json:
        sys.stdout.write(json.dumps({**common, "runs": results}, indent=2) + "\n")
    else:
        _print_tables({_title(options, results): POSES, **MORE_TABLES}, results)


def _print_tables(tables: dict[str, Columns], runs: Sequence[Result]) -> None:
    console = Console(emoji=False, markup=False, highlight=False)  # "sim:office:" is not an emoji
    for heading, columns in tables.items():
        console.print(heading, soft_wrap=True)
        table = Table(*columns, box=None, padding=(0, 1, 0, 0), header_style="bold")
        for column in table.columns:
            column.justify, column.no_wrap = "right", True
        for row in table_rows(runs, columns):
            table.add_row(*row)
        console.print(table)


def _title(options: EvaluateOptions, runs: Sequence[Result]) -> str:
    of = options.recording
    if all(run["log_score_mean"] is None for run in runs):
        return f"{of}: errors unknown without true poses (--reference)"
    return f"{of}: localized in {sum(run['localized'] for run in runs)} of {len(runs)}"


def case_of(options: EvaluateOptions) -> tuple[Case, int]:
    """Return the robot and length of each run, and the number of seeds.

    Raises:
        SettingsError: options contradict each other.
    """
    robot = _robot_of(options)
    simulated = isinstance(robot, SimulatedRobot)
    if simulated and options.starts is not None and options.seeds > 1:
        problem = "--seeds: every start of a simulated robot has a seed of its own; leave it out"
        raise SettingsError(key="--seeds", problem=problem)
    default = DEFAULT_STEPS if simulated else None  # None: to the recording's end
    if options.starts is not None:
        default = DEFAULT_STEPS_OF_A_START
    seeds = options.starts if simulated and options.starts is not None else options.seeds
    case = Case(robot=robot, updates=options.steps or default)
    return case, seeds


def start_steps(steps: int, starts: int, steps_each: int) -> tuple[int, ...]:
    """Return start steps of runs, evenly from 0 to the last from which a full run fits.

    Raises:
        SettingsError: the recording is too short for this number of starts.
    """
    last = max(steps - steps_each, 0)
    if starts > last + 1:
        problem = f"--starts {starts}: {steps} steps allow {last + 1} starts of {steps_each} steps"
        raise SettingsError(key="--starts", problem=problem)
    return tuple(round(index * last / max(starts - 1, 1)) for index in range(starts))


def _robot_of(options: EvaluateOptions) -> SimulatedRobot | RecordedRobot:
    named = map_file_of(options.map_file or "", options.recording)
    map_file = Path(named) if named else None
    source = parsed_source(options.recording)
    if isinstance(source, Simulated):
        if options.reference:
            problem = "--reference: a simulated robot knows where it is; leave it out"
            raise SettingsError(key="--reference", problem=problem)
        return SimulatedRobot(world=source.world, map=map_file)
    if map_file is None:
        problem = "--map is missing: a recording needs the map it was made in"
        raise SettingsError(key="--map", problem=problem)
    if options.kidnap_at is not None:
        problem = "--kidnap-at: only a simulated robot can be kidnapped"
        raise SettingsError(key="--kidnap-at", problem=problem)
    return RecordedRobot(
        recording=Path(options.recording), map=map_file, reference=options.reference
    )


def _steps_count(run: Run) -> int:
    """Return the number of steps of the robot; opens all inputs, which checks them."""
    if isinstance(run.case.robot, SimulatedRobot):
        next(run.begun()[0].steps)
        return run.case.updates or DEFAULT_STEPS
    whole = replace(run, case=msgspec.structs.replace(run.case, updates=None))
    return sum(1 for _ in whole.begun()[0].steps)


def _all_results(options: EvaluateOptions, runs: Sequence[Run], steps: int) -> list[RunMeasures]:
    """Execute the runs, in parallel if there are several; return their measures in order."""
    stop = stop_on_signals(exit_after_s=5.0)
    done: dict[int, RunMeasures] = {}
    with _progress() as progress:
        bar = progress.add_task("steps", total=steps * len(runs))

        def on_update() -> None:
            stop.check()
            progress.advance(bar)

        if len(runs) == 1:
            done[0] = executed(options, runs[0], on_update)
        else:
            jobs, work = options.jobs or os.cpu_count() or 1, partial(executed, options)
            for index, finished in in_parallel(work, runs, jobs, stop):
                progress.advance(bar, finished.steps)
                done[index] = finished
    stop.check()
    return [done[index] for index in range(len(runs))]


def _progress() -> Progress:
    """Return a progress bar on standard error; hidden with ``--quiet`` or without a terminal."""
    console = Console(stderr=True, emoji=False)
    hidden = is_quiet() or not console.is_terminal
    return Progress(console=console, transient=True, disable=hidden)
