"""`clustermcl evaluate`: localize in one process as often as asked, and measure how well.

It is one experiment more, made of a person's options instead of taken from the catalogue.
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
"""Of a simulated robot, which never stops by itself."""
DEFAULT_STEPS_OF_A_START = 60


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """What a person asked for."""

    recording: str
    map_file: str | None = None
    reference: Path | None = None
    algorithm: str = "cluster-mcl"
    seeds: int = 1
    starts: int | None = None
    """Runs begin at so many steps of a recording, spread evenly; of a simulated robot, each with
    a seed of its own."""
    steps: int | None = None
    kidnap_at: int | None = None
    mirrored: bool = False
    """See every scan and motion in a mirror: how a robot fares that is nowhere in the map."""
    jobs: int | None = None
    as_json: bool = False
    """Print JSON instead of tables."""
    output: Path | None = None
    """Where the same JSON is written; None: nowhere."""
    record: Path | None = None
    """Where the run, which must be one, is recorded; None: nowhere."""
    report_file: Path | None = None
    """A page of HTML, opened by file."""


def run_evaluate(options: EvaluateOptions, settings: Settings) -> None:
    """Run all seeds, print tables or JSON, and write what is asked for.

    Raises:
        ClusterMclError: an input cannot be used, or a run failed.
        StoppedError: interrupted.
    """
    algorithm, case = algorithm_named(options.algorithm), case_of(options)
    for file in (options.output, options.report_file):
        if file is not None:
            check_output_file(file)
    if isinstance(case.robot, RecordedRobot):
        opened(options.recording, settings.bridge)  # says which lines are left out, once
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
    steps = _steps_count(tasks[0])  # says what is wrong before any process is started
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
    console = Console(emoji=False, markup=False, highlight=False)  # "sim:office:" is no emoji
    for heading, columns in {title: _POSES, **_MORE_TABLES}.items():
        console.print(heading, soft_wrap=True)
        console.print(_table(results, columns))


def _check_record(file: Path, runs: int) -> None:
    if runs > 1:
        problem = "--record: of one run; leave out --seeds and --starts"
        raise SettingsError(key="--record", problem=problem)
    check_output_file(file)


def case_of(options: EvaluateOptions) -> Case:
    """The experiment that is asked for.

    Raises:
        SettingsError: options that do not fit together.
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
    """Steps of a run if a person does not say; None: to the recording's end."""
    if options.starts is not None:
        return DEFAULT_STEPS_OF_A_START
    return DEFAULT_STEPS if simulated else None


def start_steps(steps: int, starts: int, steps_each: int) -> tuple[int, ...]:
    """The steps at which runs begin, from the first one on to the last one that leaves room.

    Args:
        steps: of the recording.
        starts: how many are wanted.
        steps_each: of one run.

    Raises:
        SettingsError: the recording has not so many different starts.
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
    """How many steps there are for a run, having read every input as far as that takes.

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
    """The result of every run, in their order, and the steps of those that keep them.

    As many at a time as there are cores.
    """
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
    """On standard error, and only where somebody looks."""
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
"""Columns: the key of a run's number, and its form."""
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
    """What a report says of its origin."""
    command = shlex.join(["clustermcl", *sys.argv[1:]])
    return f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC, version {version('clustermcl')}: {command}"


def _table_text(runs: Sequence[dict[str, Any]], columns: dict[str, tuple[str, str]]) -> TableText:
    """For the page."""
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
