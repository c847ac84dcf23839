"""`clustermcl evaluate`: localize in one process as often as asked, and measure how well."""

import json
import os
from collections.abc import Callable, Sequence
from functools import partial
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

from evaluation.evaluation import ALGORITHMS, EvaluateOptions, Run, evaluated, seeded, steps_count
from evaluation.experiments.parallel import Advanced, Done, Failed, in_parallel
from evaluation.recordings import opened
from process_runtime.settings import Settings
from process_runtime.stop import stop_on_signals
from protocol.errors import ClusterMclError, InputFileError, SettingsError


class RunFailedError(ClusterMclError):
    """A run came to no end."""

    def __init__(self, *, seed: int, problem: str) -> None:
        self.seed, self.problem = seed, problem
        super().__init__(f"seed {seed}: {problem}")


def run_evaluate(options: EvaluateOptions, settings: Settings) -> None:
    """Run all seeds, print a table, and write the JSON where one is asked for.

    Raises:
        ClusterMclError: an input cannot be used, or a run failed.
        StoppedError: interrupted.
    """
    _refuse_what_does_not_fit(options)
    if not options.simulated:
        opened(options.recording, settings.bridge)  # says which lines are left out, once
    runs = seeded(options, settings)
    steps = steps_count(runs[0])  # says what is wrong before any process is started
    results = _all_results(runs, steps, options.jobs)
    if options.json_file is not None:
        _write(options, results)
    Console().print(_table(results, f"{options.algorithm} on {options.recording}"))


def _refuse_what_does_not_fit(options: EvaluateOptions) -> None:
    if options.algorithm not in ALGORITHMS:
        known = " or ".join(ALGORITHMS)
        problem = f"--algorithm {options.algorithm}: there is {known}"
        raise SettingsError(key="--algorithm", problem=problem)
    if options.simulated and options.reference:
        problem = "--reference: a simulated robot knows where it is; leave it out"
        raise SettingsError(key="--reference", problem=problem)
    if not options.simulated and not options.map_file:
        problem = "--map is missing: a recording needs the map it was made in"
        raise SettingsError(key="--map", problem=problem)
    if not options.simulated and options.kidnap_at is not None:
        problem = "--kidnap-at: only a simulated robot can be kidnapped"
        raise SettingsError(key="--kidnap-at", problem=problem)
    if options.json_file is not None and not options.json_file.parent.is_dir():
        raise InputFileError(options.json_file, "its folder does not exist")


def _all_results(runs: Sequence[Run], steps: int, jobs: int | None) -> list[dict[str, Any]]:
    """The result of every run, in their order; as many at a time as there are cores."""
    stop = stop_on_signals(exit_after_s=5.0)
    done: dict[int, dict[str, Any]] = {}
    with _progress() as progress:
        bar = progress.add_task("steps", total=steps * len(runs))
        for event in in_parallel(evaluated, runs, jobs or os.cpu_count() or 1, stop):
            match event:
                case Advanced(amount=amount):
                    progress.advance(bar, amount)
                case Done(piece=piece, result=result):
                    done[piece] = result
                case Failed(piece=piece, problem=problem):
                    raise RunFailedError(seed=runs[piece].settings.seed, problem=problem)
    stop.check()
    return [done[piece] for piece in range(len(runs))]


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


def _write(options: EvaluateOptions, results: Sequence[dict[str, Any]]) -> None:
    assert options.json_file is not None  # asked for by the caller
    whole = {
        "algorithm": options.algorithm,
        "recording": options.recording,
        "map": options.map_file,
        "runs": results,
    }
    try:
        options.json_file.write_text(json.dumps(whole, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputFileError(options.json_file, error.strerror or str(error)) from error


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
