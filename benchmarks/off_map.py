"""How often is a robot called localized that is not on the map, and how often one that is?

    python -m benchmarks.off_map [NAME...] [--baseline KEY=VALUE]

A NAME is part of the name of a condition (`off_map_robots`) or its group. The folder of recordings
is that of CLUSTERMCL_DATA.
"""

import itertools
import math
import os
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
import typer

from benchmarks.experiments.catalogue import DATA_VARIABLE
from benchmarks.off_map_robots import Condition, conditions
from benchmarks.same_views import Answer, answer_of
from clustermcl.belief.outcome import Outcome
from clustermcl.evaluation.measures import CONFIDENT_PROBABILITY
from clustermcl.jobs.in_process import InProcess
from clustermcl.jobs.map_model import sensor_model
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import Scan
from clustermcl.runtime.folders import kept_folder
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings

MOST_SDS = 5.0
WARM_UP_STEPS = 3
"""Not counted in CPU times: compiled kernels are loaded in them."""


class Row(msgspec.Struct, frozen=True):
    """One step of a run."""

    state: str
    probability: float
    """Of the most probable place."""
    right: bool
    on_map: bool
    truth: float
    """Probability of all right places."""
    none: float
    """Probability that the robot is at no tracked place."""
    off_map: float
    """Of that, that it is not on the map."""
    error_m: float
    """Of the most probable place; NaN: the truth is unknown."""
    sds: float
    """The same error in the place's own standard deviations."""
    cpu_s: float
    """CPU time of the step."""

    @property
    def localized(self) -> bool:
        """Called so."""
        return self.state == "localized"


class Result(msgspec.Struct, frozen=True):
    """A run."""

    group: str
    name: str
    event_at: int | None
    rows: list[Row]
    baseline_cpu_s: float
    """CPU time of the same steps with the baseline's settings, after the warm-up."""


# --- runs


class _Timed(InProcess):
    """Measures the CPU time of each step."""

    cpu_s = 0.0

    def timed(self, scan: Scan) -> Outcome:
        """Apply a step."""
        before_s = time.process_time()
        outcome = self.advance(scan)
        self.cpu_s = time.process_time() - before_s
        return outcome


def run(condition: Condition, settings: Settings, baseline: Settings | None = None) -> Result:
    """Localize.

    Args:
        condition: the robot and the map.
        settings: of the filter.
        baseline: the settings of a second filter, which has the same steps in turn; None: none.
    """
    grid_map, steps = condition.begin()
    model = sensor_model(grid_map, settings.sensor, kept_folder("maps"))
    process = _Timed(model, settings)
    other = _Timed(model, baseline) if baseline else None
    rows: list[Row] = []
    baseline_cpu_s = 0.0
    for scan, truth, on_map in itertools.islice(steps, condition.steps):
        if other is not None and len(rows) % 2:
            other.timed(scan)
        outcome = process.timed(scan)
        if other is not None:
            if not len(rows) % 2:
                other.timed(scan)
            baseline_cpu_s += other.cpu_s if len(rows) >= WARM_UP_STEPS else 0.0
        rows.append(_row(outcome, truth, on_map=on_map, cpu_s=process.cpu_s))
    return Result(condition.group, condition.name, condition.event_at, rows, baseline_cpu_s)


def _row(outcome: Outcome, truth: PoseTuple | None, *, on_map: bool, cpu_s: float) -> Row:
    places = outcome.hypotheses
    nowhere = Answer(
        0.0, places[0].probability if places else 0.0, False, math.nan, math.nan, outcome.state
    )
    answer = nowhere if truth is None else answer_of(outcome, truth)
    return Row(
        state=outcome.state,
        probability=answer.best,
        right=answer.is_right,
        on_map=on_map,
        truth=answer.truth,
        none=outcome.elsewhere_probability,
        off_map=outcome.off_map_probability,
        error_m=answer.error_m,
        sds=answer.sds,
        cpu_s=cpu_s,
    )


# --- the table


def _percent(flags: Sequence[bool]) -> str:
    return f"{100.0 * np.mean(flags):6.1f}" if len(flags) else "     -"


HEADER = (
    f"{'':40}  called  lost  none   off  sure+wrong  sure at  score  steps off the map: "
    "called  lost at  beyond 5 sd of the reported error"
)


def line(result: Result) -> str:
    """One run."""
    rows = result.rows
    on = [row for row in rows if row.on_map]
    off = [row for row in rows if not row.on_map]
    wrong = [row.localized and not row.right for row in rows]
    sure = [
        i for i, row in enumerate(rows) if row.right and row.probability >= CONFIDENT_PROBABILITY
    ]
    if result.event_at is not None:
        sure = [i - result.event_at for i in sure if i >= result.event_at]
        noticed = [
            i - result.event_at
            for i, row in enumerate(rows)
            if i >= result.event_at and not row.localized
        ]
        extra = f"  noticed after {noticed[0] if noticed else '-'}"
    else:
        extra = ""
    score = np.mean([math.log(max(row.truth, 0.001)) for row in on]) if on else math.nan
    lost = [i for i, row in enumerate(rows) if row.state == "lost"]
    return (
        f"{result.group + ', ' + result.name:40} {_percent([r.localized for r in rows])} "
        f"{_percent([r.state == 'lost' for r in rows])} {np.mean([r.none for r in rows]):5.2f} "
        f"{np.mean([r.off_map for r in rows]):5.2f} {_percent(wrong):>10} "
        f"{sure[0] if sure else '-':>8} {score:7.2f} {'':18}{_percent([r.localized for r in off])}"
        f"  {lost[0] if lost and off else '-':>6}  {_reported_error([result])}{extra}"
        f"  {_cost([result])}"
    )


def summary(group: str, results: Sequence[Result]) -> str:
    """All runs of a group."""
    wrong = [np.mean([r.localized and not r.right for r in one.rows]) for one in results]
    called = [np.mean([r.localized for r in one.rows]) for one in results]
    off = [np.mean(f) for one in results if (f := [r.localized for r in one.rows if not r.on_map])]
    on = [math.log(max(r.truth, 0.001)) for one in results for r in one.rows if r.on_map]
    score = f"{np.mean(on):6.2f}" if on else "     -"
    return (
        f"{group:28} {len(results):3} runs  localized {100 * np.mean(called):5.1f} "
        f"({100 * min(called):.0f} to {100 * max(called):.0f})  sure and wrong "
        f"{100 * np.mean(wrong):5.1f} ({100 * max(wrong):.0f})  off the map, localized "
        + (f"{100 * np.mean(off):5.1f} ({100 * max(off):.0f})" if off else "    -")
        + f"  score {score}  {_reported_error(results)}  {_cost(results)}"
    )


def _reported_error(results: Sequence[Result]) -> str:
    """Return how many estimates of a right place are farther off than they say, and the RMSE."""
    right = [row for one in results for row in one.rows if row.right]
    if not right:
        return "-"
    rmse_m = math.sqrt(np.mean([row.error_m**2 for row in right]))
    return f"{sum(row.sds > MOST_SDS for row in right)} of {len(right)} ({rmse_m:.3f} m)"


def _cost(results: Sequence[Result]) -> str:
    """Return the CPU time of a step; its ratio to that of the baseline."""
    rows = [row for one in results for row in one.rows[WARM_UP_STEPS:]]
    text = f"{1000 * np.mean([row.cpu_s for row in rows]):.0f} ms a step"
    if baseline_s := math.fsum(one.baseline_cpu_s for one in results):
        text += f", {math.fsum(row.cpu_s for row in rows) / baseline_s:.2f} of the baseline"
    return text


def main(
    names: Annotated[list[str] | None, typer.Argument()] = None,
    jobs: int = 2,
    baseline: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", help="Compare CPU time with that of these settings."),
    ] = None,
) -> None:
    """Run and print."""
    named = os.environ.get(DATA_VARIABLE)
    chosen = [
        one
        for one in conditions(Path(named) if named else None)
        if not names or any(name in f"{one.group}, {one.name}" for name in names)
    ]
    results: list[Result] = []
    print(HEADER)
    with ProcessPoolExecutor(jobs) as pool:
        waiting = [
            pool.submit(run_numbered, named, i.group, i.name, baseline or ()) for i in chosen
        ]
        for future in waiting:
            result = future.result()
            print(line(result), flush=True)
            results.append(result)
    groups = dict.fromkeys(result.group for result in results)
    for group in groups:
        print(summary(group, [result for result in results if result.group == group]))


def run_numbered(data: str | None, group: str, name: str, baseline: Sequence[str]) -> Result:
    """One condition, in a process of its own."""
    known = conditions(Path(data) if data else None)
    condition = next(one for one in known if (one.group, one.name) == (group, name))
    return run(condition, Settings(), load_settings(None, baseline) if baseline else None)


if __name__ == "__main__":
    typer.run(main)
