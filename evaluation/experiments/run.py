"""The command `clustermcl experiments` from its options to the report."""

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console

from evaluation.experiments.case import Case
from evaluation.experiments.catalogue import simulated_cases
from evaluation.experiments.draw import draw_all
from evaluation.experiments.map_cases import map_cases
from evaluation.experiments.plan import Extent, Given, chosen, estimated_s, extended, tasks_of
from evaluation.experiments.plots import MISSING, can_plot
from evaluation.experiments.progress_view import ProgressView
from evaluation.experiments.provenance import provenance
from evaluation.experiments.recorded import DATA_VARIABLE, WEAN_NAMES, recorded_cases
from evaluation.experiments.report import ReportInput, report_text
from evaluation.experiments.results import write_text
from evaluation.experiments.suite import Suite
from process_runtime.output_files import check_output_file, check_output_folder
from process_runtime.stop import StopFlag
from protocol.errors import ClusterMclError
from worker.map_model import default_cache_folder


class FailedRunsError(ClusterMclError):
    """Some runs failed; all that did not is reported."""

    def __init__(self, failed: int, runs: int, report: Path) -> None:
        self.failed, self.runs, self.report = failed, runs, report
        super().__init__(f"{failed} of {runs} runs failed; {report} says why")


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a person asked for."""

    names: Sequence[str] = ()
    """Experiments; none: all."""
    extent: Extent = field(default_factory=Extent)
    out: Path
    report: Path | None = None
    """None: `experiments.md` in `out`."""
    data: Path | None = None
    """Folder of recordings; None: the environment variable's."""
    jobs: int | None = None
    """None: one for each core."""
    given: Given = field(default_factory=Given)
    """Settings."""
    plots: bool = True
    """Draw them, where matplotlib is installed."""
    command: str = "clustermcl experiments"
    """As it was typed, for the report."""

    @property
    def report_file(self) -> Path:
        """Where the report goes."""
        return self.report or self.out / "experiments.md"


def available(data: Path | None) -> tuple[tuple[Case, ...], tuple[str, ...]]:
    """All experiments that could be run, and a sentence for what is left out.

    Args:
        data: folder of recordings; None: the environment variable's.
    """
    named = os.environ.get(DATA_VARIABLE)
    folder = data or (Path(named) if named else None)
    recorded = recorded_cases(folder)
    cases = (*simulated_cases(), *recorded, *map_cases(folder))
    if not recorded:
        where = f"none in {folder}" if folder else f"give --data or set {DATA_VARIABLE}"
        return cases, (f"Recordings are left out: {where}.",)
    missing = sorted(set(WEAN_NAMES) - {case.name for case in recorded})
    return cases, (f"Left out, not in {folder}: {', '.join(missing)}.",) if missing else ()


def run_experiments(options: Options, stop: StopFlag, console: Console) -> Path | None:
    """Run experiments and write their files, plots and the report.

    Args:
        options: which, and where to.
        stop: ends it early; what has ended is reported.
        console: for people.

    Returns:
        The report; None if it was stopped before any run had ended.

    Raises:
        ClusterMclError: a name or a setting is wrong, or a file cannot be written; or, once all
            is written, that some runs failed.
    """
    started_s = time.monotonic()
    known, left_out = available(options.data)
    cases = chosen(known, options.names, "; ".join(("", *left_out)))
    left_out = () if options.names else left_out
    cases = tuple(extended(case, options.extent) for case in cases)
    settings = options.given.settings()
    tasks = tasks_of(cases, options.extent.first_seed, options.given, default_cache_folder())
    check_output_folder(options.out)
    check_output_folder(options.report_file.parent)
    if options.report_file.exists():
        check_output_file(options.report_file)
    jobs = options.jobs or _cores()
    suite = Suite(cases, provenance(options.command, settings, jobs), options.out)
    minutes = estimated_s(tasks, jobs) / 60
    size = f"{len(cases)} experiments, {len(tasks)} runs in {jobs} processes"
    for line in (*left_out, f"{size}: about {minutes:.0f} min on an idle machine"):
        console.print(line, highlight=False, soft_wrap=True)
    with ProgressView(console, tasks) as view:
        suite.run(tasks, jobs, stop, view.tell)
    if not suite.begun:
        return None
    report = _reported(options, suite, left_out, time.monotonic() - started_s, stop, console)
    if suite.failed:
        raise FailedRunsError(suite.failed, len(tasks), report)
    return report


def _reported(
    options: Options,
    suite: Suite,
    left_out: Sequence[str],
    wall_s: float,
    stop: StopFlag,
    console: Console,
) -> Path:
    """Draw the plots, if that can be done, and write the report."""
    plots: dict[str, Sequence[Path]] = {}
    if options.plots and can_plot():
        plots = draw_all(suite.begun, suite.traces, options.out)
    elif options.plots:
        console.print(MISSING, highlight=False, soft_wrap=True, markup=False)
    report = options.report_file
    given = ReportInput(
        provenance=suite.provenance,
        results=suite.begun,
        left_out=left_out,
        plots=plots,
        wall_s=wall_s,
        interrupted=stop.is_set(),
        quick=options.extent.quick,
    )
    return write_text(report, report_text(given, report.parent))


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
