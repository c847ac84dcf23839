"""`clustermcl evaluate`: localizes in one process, repeatedly, and measures the accuracy.

It runs one experiment built from the options instead of one from the catalogue.
"""

import json
import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from evaluation.experiments.case import (
    AfterStep,
    Case,
    RecordedRobot,
    SimulatedRobot,
    algorithm_named,
)
from evaluation.experiments.measures import RunMeasures
from evaluation.experiments.pool import in_parallel
from evaluation.experiments.task import Finished, Run, Task, run_task
from evaluation.experiments.trace import Trace
from evaluation.recordings import opened
from evaluation.report_page import DRAWN_RUNS, TableText, report_page
from process_runtime.logs import is_quiet
from process_runtime.output_files import check_output_file, write_output_file
from process_runtime.settings import Settings
from process_runtime.sources import Simulated, parsed_source
from process_runtime.stop import stop_on_signals
from protocol.errors import SettingsError
from recordings.map_file import map_file_of

DEFAULT_STEPS = 300
"""Steps of a simulated robot, which never ends by itself."""
DEFAULT_STEPS_OF_A_START = 60


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """Options of the command."""

    recording: str
    map_file: str | None = None
    reference: Path | None = None
    algorithm: str = "cluster-mcl"
    seeds: int = 1
    starts: int | None = None
    """Number of runs: from start steps spread evenly over a recording, or with different seeds of
    a simulated robot."""
    steps: int | None = None
    kidnap_at: int | None = None
    mirrored: bool = False
    """Mirror every scan and motion: a robot that is nowhere on the map."""
    jobs: int | None = None
    as_json: bool = False
    """Print JSON instead of tables."""
    output: Path | None = None
    """File for the JSON; None: none."""
    record: Path | None = None
    """File for the recording of a single run; None: none."""
    report_file: Path | None = None
    """File for an HTML page."""


def run_evaluate(options: EvaluateOptions, settings: Settings) -> None:
    """Run all seeds, print tables or JSON, and write the requested files.

    Raises:
        ClusterMclError: an input cannot be used, or a run failed.
        StoppedError: interrupted.
    """
    algorithm, case = algorithm_named(options.algorithm), case_of(options)
    for file in (options.output, options.report_file):
        if file is not None:
            check_output_file(file)
    if isinstance(case.robot, RecordedRobot):
        opened(options.recording, settings.bridge)  # reports the skipped lines, once
    seeds = range(settings.seed, settings.seed + case.seeds)
    tasks = [
        Task(
            case=case,
            algorithm=algorithm,
            seed=seed,
            settings=settings,
            record=options.record,
        )
        for seed in seeds
    ]
    steps = _steps_count(tasks[0])  # raises input errors before any process is started
    if options.starts is not None and isinstance(case.robot, RecordedRobot):
        starts = start_steps(steps, options.starts, case.updates or steps)
        tasks = [replace(task, start_step=start) for start in starts for task in tasks]
    if options.record is not None:
        _check_record(options.record, len(tasks))
    if options.report_file is not None:
        tasks = [replace(task, with_trace=index < DRAWN_RUNS) for index, task in enumerate(tasks)]
    results, traces = _all_results(tasks, min(steps, case.updates or steps), options.jobs)
    text = _as_json(options, results)
    if options.output is not None:
        write_output_file(options.output, text)
    right = sum(run["localized"] for run in results)
    of = f"{options.algorithm} on {options.recording}"
    title = f"{of}: localized in {right} of {len(results)}"
    if options.mirrored:
        title = f"{of}, mirrored: a robot that is nowhere in the map"
    if options.report_file is not None:
        tables = [_table_text(results, columns) for columns in (_POSES, *_MORE_TABLES.values())]
        page = report_page(title, _made_by(), Run(tasks[0]).course.map, traces, tables)
        write_output_file(options.report_file, page)
    if options.as_json:
        sys.stdout.write(text)
        return
    console = Console(emoji=False, markup=False, highlight=False)  # "sim:office:" is not an emoji
    for heading, columns in {title: _POSES, **_MORE_TABLES}.items():
        console.print(heading, soft_wrap=True)
        console.print(_table(results, columns))


def _check_record(file: Path, runs: int) -> None:
    if runs > 1:
        problem = "--record: of one run; leave out --seeds and --starts"
        raise SettingsError(key="--record", problem=problem)
    check_output_file(file)


def case_of(options: EvaluateOptions) -> Case:
    """Return the experiment of the options.

    Raises:
        SettingsError: options contradict each other.
    """
    robot = _robot_of(options)
    simulated = isinstance(robot, SimulatedRobot)
    if simulated and options.starts is not None and options.seeds > 1:
        problem = "--seeds: every start of a simulated robot has a seed of its own; leave it out"
        raise SettingsError(key="--seeds", problem=problem)
    updates = options.steps or _usual_steps(options, simulated=simulated)
    seeds = options.starts if simulated and options.starts is not None else options.seeds
    return Case(
        name="evaluate",
        title=options.recording,
        robot=robot,
        updates=updates,
        seeds=seeds,
        mirrored=options.mirrored,
    )


def _usual_steps(options: EvaluateOptions, *, simulated: bool) -> int | None:
    """Return the default number of steps of a run; None: to the recording's end."""
    if options.starts is not None:
        return DEFAULT_STEPS_OF_A_START
    return DEFAULT_STEPS if simulated else None


def start_steps(steps: int, starts: int, steps_each: int) -> tuple[int, ...]:
    """Return the start steps of runs, evenly from 0 to the last that leaves a full run.

    Args:
        steps: steps of the recording.
        starts: number of runs.
        steps_each: steps of a run.

    Raises:
        SettingsError: the recording is too short for this number of starts.
    """
    last = max(steps - steps_each, 0)
    if starts > last + 1:
        problem = f"--starts {starts}: {steps} steps have {last + 1} starts with {steps_each} each"
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
        return SimulatedRobot(
            world=source.world,
            map=map_file,
            kidnapping=None if options.kidnap_at is None else AfterStep(options.kidnap_at),
        )
    if map_file is None:
        problem = "--map is missing: a recording needs the map it was made in"
        raise SettingsError(key="--map", problem=problem)
    if options.kidnap_at is not None:
        problem = "--kidnap-at: only a simulated robot can be kidnapped"
        raise SettingsError(key="--kidnap-at", problem=problem)
    return RecordedRobot(
        recording=Path(options.recording), map=map_file, reference=options.reference
    )


def _steps_count(task: Task) -> int:
    """Return the number of available steps, after checking the inputs.

    Raises:
        ClusterMclError: an input cannot be used.
    """
    match task.case.robot:
        case SimulatedRobot():
            next(Run(task).course.steps)
            return task.case.updates or DEFAULT_STEPS
        case RecordedRobot():
            whole = replace(task, case=msgspec.structs.replace(task.case, updates=None))
            return sum(1 for _ in Run(whole).course.steps)


def _all_results(
    tasks: Sequence[Task], steps: int, jobs: int | None
) -> tuple[list[dict[str, Any]], list[Trace]]:
    """Run one task per core; return all results in order, and the steps of runs that keep them."""
    stop = stop_on_signals(exit_after_s=5.0)
    done: dict[int, Finished] = {}
    with _progress() as progress:
        bar = progress.add_task("steps", total=steps * len(tasks))

        def on_update() -> None:
            stop.check()
            progress.advance(bar)

        if len(tasks) == 1:
            done[0] = run_task(tasks[0], on_update)
        else:
            for piece, finished in in_parallel(run_task, tasks, jobs or os.cpu_count() or 1, stop):
                progress.advance(bar, finished.measures.updates)
                done[piece] = finished
    stop.check()
    results = [
        result_of(task.seed, done[piece].measures, task.start_step)
        for piece, task in enumerate(tasks)
    ]
    traces = (done[piece].trace for piece in range(len(tasks)))
    return results, [trace for trace in traces if trace is not None]


def result_of(seed: int, measures: RunMeasures, start_step: int = 0) -> dict[str, Any]:
    """An entry in `runs` of the JSON; steps are counted from 0, updates from 1.

    `start_step` counts the steps of the recording; all others count those of the run.
    """
    settled, sure = measures.settled_at_update, measures.sure_and_right_at_update
    return {
        "seed": seed,
        "start_step": start_step,
        "steps": measures.updates,
        "localized": measures.localized,
        "final_error_m": measures.final_error_m,
        "final_error_rad": measures.final_error_rad,
        "localized_at_step": None if settled is None else settled - 1,
        "localized_at_s": measures.settled_after_s,
        "confidently_wrong_fraction": measures.confidently_wrong_share,
        "truth_tracked_fraction": measures.tracked_share,
        "truth_probability_mean": measures.truth_probability,
        "rmse_m": measures.rmse_m,
        "sure_and_right_at_step": None if sure is None else sure - 1,
        "log_score_mean": measures.log_score,
        "truth_probability_lowest_once_sure": measures.truth_lowest_once_sure,
        "brier_mean": measures.brier,
        "elsewhere_probability_mean": measures.elsewhere_probability,
        "off_map_probability_mean": measures.off_map_probability,
        "localized_fraction": measures.localized_share,
        "ambiguous_fraction": measures.ambiguous_share,
        "lost_fraction": measures.lost_share,
        "searching_fraction": measures.searching_share,
        "wall_s": measures.wall_s,
        "cpu_s": measures.cpu_s,
    }


def _progress() -> Progress:
    """Show progress on standard error, if that is a terminal."""
    console = Console(stderr=True, emoji=False)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=is_quiet() or not console.is_terminal,
    )


def _as_json(options: EvaluateOptions, results: Sequence[dict[str, Any]]) -> str:
    whole = {
        "algorithm": options.algorithm,
        "recording": options.recording,
        "mirrored": options.mirrored,
        "map": options.map_file,
        "runs": results,
    }
    return json.dumps(whole, indent=2) + "\n"


_POSES = {
    "seed": ("seed", "d"),
    "from": ("start_step", "d"),
    "at step": ("localized_at_step", "d"),
    "s": ("localized_at_s", ".1f"),
    "error m": ("final_error_m", ".2f"),
    "rad": ("final_error_rad", ".3f"),
    "rmse m": ("rmse_m", ".3f"),
    "wrong": ("confidently_wrong_fraction", ".3f"),
    "steps": ("steps", "d"),
    "wall s": ("wall_s", ".1f"),
    "cpu s": ("cpu_s", ".1f"),
}
"""Columns: the key of a run's measure, and its format."""
_STATES = {
    "seed": ("seed", "d"),
    "from": ("start_step", "d"),
    "localized": ("localized_fraction", ".3f"),
    "ambiguous": ("ambiguous_fraction", ".3f"),
    "lost": ("lost_fraction", ".3f"),
    "searching": ("searching_fraction", ".3f"),
    "p(elsewhere)": ("elsewhere_probability_mean", ".2f"),
    "p(off map)": ("off_map_probability_mean", ".2f"),
}
_PROBABILITIES = {
    "seed": ("seed", "d"),
    "from": ("start_step", "d"),
    "sure at": ("sure_and_right_at_step", "d"),
    "then never under": ("truth_probability_lowest_once_sure", ".2f"),
    "tracked": ("truth_tracked_fraction", ".3f"),
    "p(truth)": ("truth_probability_mean", ".2f"),
    "log": ("log_score_mean", ".2f"),
    "brier": ("brier_mean", ".2f"),
}


_MORE_TABLES = {
    "probability of the true place": _PROBABILITIES,
    "share of the steps in each state": _STATES,
}


def _made_by() -> str:
    """Return the report's origin: date, version, command."""
    command = shlex.join(["clustermcl", *sys.argv[1:]])
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, version {version('clustermcl')}: {command}"


def _table_text(runs: Sequence[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> TableText:
    rows = [[_shown(run[key], form) for key, form in columns.values()] for run in runs]
    return TableText(list(columns), rows)


def _table(runs: Sequence[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> Table:
    table = Table(box=None, padding=(0, 1, 0, 0), header_style="bold")
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for run in runs:
        table.add_row(*(_shown(run[key], form) for key, form in columns.values()))
    return table


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
