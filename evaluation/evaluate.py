"""`clustermcl evaluate`: localize in one process as often as asked, and measure how well.

It is one experiment more, made of a person's options instead of taken from the catalogue.
"""

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

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
from rich.text import Text

from evaluation.experiments.case import (
    ALGORITHMS,
    AfterStep,
    Algorithm,
    Case,
    RecordedRobot,
    SimulatedRobot,
)
from evaluation.experiments.measures import RunMeasures
from evaluation.experiments.parallel import Advanced, Done, Failed, in_parallel
from evaluation.experiments.task import PROGRESS_EVERY, Run, Task, run_task
from evaluation.recordings import opened
from grid_maps.load import map_file_of
from process_runtime.settings import Settings
from process_runtime.sources import Simulated, parsed_source
from process_runtime.stop import stop_on_signals
from protocol.errors import ClusterMclError, InputFileError, SettingsError
from worker.map_model import default_cache_folder

DEFAULT_STEPS = 300
"""Of a simulated robot, which never stops by itself."""


class RunFailedError(ClusterMclError):
    """A run came to no end."""

    def __init__(self, *, seed: int, problem: str) -> None:
        self.seed, self.problem = seed, problem
        super().__init__(f"seed {seed}: {problem}")


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """What a person asked for."""

    recording: str
    map_file: str | None = None
    reference: Path | None = None
    algorithm: str = "cluster-mcl"
    seeds: int = 1
    steps: int | None = None
    kidnap_at: int | None = None
    jobs: int | None = None
    json_file: Path | None = None


def run_evaluate(options: EvaluateOptions, settings: Settings) -> None:
    """Run all seeds, print a table, and write the JSON where one is asked for.

    Raises:
        ClusterMclError: an input cannot be used, or a run failed.
        StoppedError: interrupted.
    """
    algorithm, case = algorithm_of(options), case_of(options)
    if options.json_file is not None and not options.json_file.parent.is_dir():
        raise InputFileError(options.json_file, "its folder does not exist")
    if isinstance(case.robot, RecordedRobot):
        opened(options.recording, settings.bridge)  # says which lines are left out, once
    tasks = [
        Task(
            case=case,
            algorithm=algorithm,
            seed=seed,
            settings=settings,
            cache_folder=default_cache_folder(),
        )
        for seed in range(settings.seed, settings.seed + options.seeds)
    ]
    steps = _steps_count(tasks[0])  # says what is wrong before any process is started
    results = _all_results(tasks, steps, options.jobs)
    if options.json_file is not None:
        _write(options, options.json_file, results)
    Console().print(_table(results, f"{options.algorithm} on {options.recording}"))


def algorithm_of(options: EvaluateOptions) -> Algorithm:
    """The algorithm that is asked for.

    Raises:
        SettingsError: there is none of that name.
    """
    for algorithm in ALGORITHMS:
        if algorithm == options.algorithm:
            return algorithm
    known = " or ".join(ALGORITHMS)
    problem = f"--algorithm {options.algorithm}: there is {known}"
    raise SettingsError(key="--algorithm", problem=problem)


def case_of(options: EvaluateOptions) -> Case:
    """The experiment that is asked for.

    Raises:
        SettingsError: options that do not fit together.
    """
    robot = _robot_of(options)
    updates = options.steps or (DEFAULT_STEPS if isinstance(robot, SimulatedRobot) else None)
    return Case(
        name="evaluate",
        title=options.recording,
        robot=robot,
        updates=updates,
        seeds=options.seeds,
        ordinary_seeds=options.seeds,
    )


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
    """How many steps a run makes, having read every input as far as that takes.

    Raises:
        ClusterMclError: an input cannot be used.
    """
    steps = Run(task).course.steps
    match task.case.robot:
        case SimulatedRobot():
            next(steps)
            return task.case.updates or DEFAULT_STEPS
        case RecordedRobot():
            return sum(1 for _ in steps)


def _all_results(tasks: Sequence[Task], steps: int, jobs: int | None) -> list[dict[str, Any]]:
    """The result of every run, in their order; as many at a time as there are cores."""
    stop = stop_on_signals(exit_after_s=5.0)
    done: dict[int, dict[str, Any]] = {}
    with _progress() as progress:
        bar = progress.add_task("steps", total=steps * len(tasks))
        for event in in_parallel(run_task, tasks, jobs or os.cpu_count() or 1, stop):
            seed = tasks[event.piece].seed
            match event:
                case Advanced(amount=amount):
                    progress.advance(bar, amount)
                case Done(piece=piece, result=finished):
                    progress.advance(bar, finished.measures.updates % PROGRESS_EVERY)
                    done[piece] = result_of(seed, finished.measures)
                case Failed(problem=problem):
                    raise RunFailedError(seed=seed, problem=problem)
    stop.check()
    return [done[piece] for piece in range(len(tasks))]


def result_of(seed: int, measures: RunMeasures) -> dict[str, Any]:
    """An entry in `runs` of the JSON; steps are counted from 0, updates from 1."""
    settled = measures.settled_at_update
    return {
        "seed": seed,
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
        "wall_s": measures.wall_s,
    }


def _progress() -> Progress:
    """On standard error, and only where somebody looks."""
    console = Console(stderr=True)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


def _write(options: EvaluateOptions, file: Path, results: Sequence[dict[str, Any]]) -> None:
    whole = {
        "algorithm": options.algorithm,
        "recording": options.recording,
        "map": options.map_file,
        "runs": results,
    }
    try:
        file.write_text(json.dumps(whole, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputFileError(file, error.strerror or str(error)) from error


def _table(runs: Sequence[dict[str, Any]], title: str) -> Table:
    right = sum(run["localized"] for run in runs)
    table = Table(box=None, padding=(0, 1, 0, 0), title_justify="left", header_style="bold")
    table.title = Text(f"{title}: localized in {right} of {len(runs)}")
    columns: dict[str, Callable[[dict[str, Any]], str]] = {
        "seed": partial(_shown, "seed", "d"),
        "ok": lambda run: "yes" if run["localized"] else "no",
        "at step": partial(_shown, "localized_at_step", "d"),
        "s": partial(_shown, "localized_at_s", ".1f"),
        "error m": partial(_shown, "final_error_m", ".2f"),
        "rad": partial(_shown, "final_error_rad", ".3f"),
        "rmse m": partial(_shown, "rmse_m", ".3f"),
        "wrong": partial(_shown, "confidently_wrong_fraction", ".3f"),
        "tracked": partial(_shown, "truth_tracked_fraction", ".3f"),
        "p(truth)": partial(_shown, "truth_probability_mean", ".2f"),
        "steps": partial(_shown, "steps", "d"),
        "wall s": partial(_shown, "wall_s", ".1f"),
    }
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for run in runs:
        table.add_row(*(shown(run) for shown in columns.values()))
    return table


def _shown(key: str, form: str, run: dict[str, Any]) -> str:
    return "-" if run[key] is None else format(run[key], form)
