"""The report of a run of experiments, in Markdown."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from evaluation.experiments.case import NAMES, Algorithm
from evaluation.experiments.provenance import Provenance
from evaluation.experiments.report_tables import figure_rows, number, seeds_text, table
from evaluation.experiments.results import ExperimentResult
from evaluation.experiments.summary_tables import baselines_of, reliability_lines

_DEFINITIONS = """\
An update is one gated scan. A place is right within 1 m and 20 degrees of the truth; the estimate
is the most probable place. Confidently wrong is an estimate with probability 0.9 or more that is
not right. Intervals in percent are Wilson's, for 95 %; behind a mean stand its lowest and its
highest run. A run that failed counts as one that did not do what was asked. All words of the
tables are defined in `evaluation/experiments/measures.py`; every run's numbers stand in the JSON
file of its experiment. The other algorithms are made of the same pieces and get the same seeds;
nothing is asked of them. Behind each of their figures stands p, how probable a difference like
this is if both do alike: McNemar's exact test of shares, Wilcoxon's signed-rank test of means and
quantiles. A quantile counts a run that never got there as later than all. Of a training building
constants were chosen; a validation building was looked at meanwhile; of a test building no choice
was ever made."""


@dataclass(frozen=True, kw_only=True)
class ReportInput:
    """What a report is about."""

    provenance: Provenance
    results: Sequence[ExperimentResult]
    """In the order of the report."""
    left_out: Sequence[str] = ()
    """What was not run, and why, a sentence each."""
    plots: dict[str, Sequence[Path]] = field(default_factory=dict)
    """By the experiment's name; those over all experiments under the empty name."""
    wall_s: float
    interrupted: bool = False
    quick: bool = False


def report_text(given: ReportInput, folder: Path) -> str:
    """The whole report.

    Args:
        given: what it is about.
        folder: where it is going to be; the paths of plots are relative to it.
    """
    lines = ["# Experiments", "", *_origin(given), "", "## What was asked", "", *_asked(given)]
    lines += ["", *reliability_lines(given.results)]
    lines += ["", *_images(given.plots.get("", ()), folder, "all")]
    for result in given.results:
        lines += [*_experiment(result, given.plots.get(result.case.name, ()), folder)]
    return "\n".join(lines).rstrip() + "\n"


def _origin(given: ReportInput) -> Iterator[str]:
    """How it was made, and what a reader must know of it."""
    origin = given.provenance
    yield "Written by `clustermcl experiments`; not edited by hand."
    yield ""
    yield f"    {origin.command}"
    yield ""
    commit = f"commit {origin.commit}" if origin.commit else "no commit known"
    yield f"* Version {origin.version}, {commit}, {origin.started}."
    yield (
        f"* {origin.machine}; {origin.jobs} processes; Python {origin.python}, "
        f"numpy {origin.numpy}, numba {origin.numba}; {given.wall_s / 60:.1f} minutes."
    )
    changed = ", ".join(f"`{name} = {value}`" for name, value in origin.settings.items())
    yield f"* Settings that differ from the defaults: {changed or 'none'}."
    yield from (f"* {sentence}" for sentence in _reservations(given))
    yield ""
    yield _DEFINITIONS


def _reservations(given: ReportInput) -> Iterator[str]:
    if given.interrupted:
        yield "**Interrupted**: only the runs that had ended are counted."
    if given.quick:
        yield "**Quick**: few and short runs, to see that everything works; no figure counts."
    yield from given.left_out
    reduced = [
        f"{result.case.name} {len(result.of('cluster-mcl'))} of {result.case.asked_seeds}"
        for result in given.results
        if result.case.asked_seeds and len(result.of("cluster-mcl")) < result.case.asked_seeds
    ]
    if reduced:
        yield f"Fewer seeds than the targets are stated for, to save time: {', '.join(reduced)}."


def _asked(given: ReportInput) -> Iterator[str]:
    """One table of all figures that have a target."""
    rows = []
    met = asked = 0
    baselines = baselines_of(given.results)
    for result in given.results:
        for figure, row in figure_rows(result):
            if figure.asks:
                rows.append((f"[{result.case.name}](#{result.case.name})", *row.texts(baselines)))
                asked += row.met != "–"
                met += row.met == "yes"
    yield f"{met} of {asked} targets are met."
    yield ""
    yield from table(("experiment", *_columns(baselines)), rows)


def _columns(baselines: Sequence[Algorithm]) -> tuple[str, ...]:
    others = (NAMES[algorithm] for algorithm in baselines)
    return "figure", "target", "Cluster-MCL", "interval or range", "met", *others


def _experiment(result: ExperimentResult, plots: Sequence[Path], folder: Path) -> Iterator[str]:
    case = result.case
    yield f"## {case.name}"
    yield ""
    yield f"{case.title}. A {case.role} building."
    yield ""
    for algorithm in case.algorithms:
        yield f"* {_runs_text(result, algorithm)}"
    if case.settings:
        yield f"* With {', '.join(f'`{setting}`' for setting in case.settings)}; not in the pool."
    failed = [run for algorithm in case.algorithms for run in result.of(algorithm) if run.problem]
    for run in failed:
        yield f"* **Failed**: {run.algorithm}, seed {run.seed}: {run.problem}"
    yield ""
    rows = [row.texts(case.baselines) for _, row in figure_rows(result)]
    yield from table(_columns(case.baselines), rows)
    yield ""
    yield from _images(plots, folder, case.name)


def _runs_text(result: ExperimentResult, algorithm: Algorithm) -> str:
    name = NAMES[algorithm]
    name = name[0].upper() + name[1:]
    runs = result.of(algorithm)
    measured = [run.measures for run in runs if run.measures is not None]
    if not measured:
        return f"{name}: no run."
    updates = sum(each.updates for each in measured)
    update_ms = 1e3 * sum(each.wall_s for each in measured) / max(updates, 1)
    error = result.reliability(algorithm).expected_calibration_error
    calibration = "" if error is None else f" Calibration error of the estimate {number(error)}."
    return (
        f"{name}: {seeds_text([run.seed for run in runs])}, {updates:,} updates, "
        f"{update_ms:.1f} ms each.{calibration}"
    )


def _images(plots: Sequence[Path], folder: Path, name: str) -> Iterator[str]:
    for plot in plots:
        path = Path(os.path.relpath(plot, folder)).as_posix()
        yield f"![{name}: {plot.stem.removeprefix(name + '-')}]({path})"
        yield ""
