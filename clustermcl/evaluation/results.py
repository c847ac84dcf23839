"""The results of evaluated runs as CSV, and as printed tables."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from clustermcl.runtime.output_files import write_output_file

Result = dict[str, Any]
"""One run: `seed`, `start_step` (of the recording) and the fields of `RunMeasures`."""
Columns = dict[str, tuple[str, str]]
"""The columns of a table: heading, and the key and the format of a run's measure."""


def write_results(file: Path, common: Result, runs: Sequence[Result]) -> None:
    rows = [{**common, **run} for run in runs]
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_output_file(file, text.getvalue())


_SEED = {"seed": ("seed", "d"), "start": ("start_step", "d")}
POSES: Columns = {
    **_SEED,
    "right from": ("localized_at_step", "d"),
    "after s": ("localized_at_s", ".1f"),
    "final m": ("final_error_m", ".2f"),
    "final rad": ("final_error_rad", ".3f"),
    "rmse m": ("rmse_m", ".3f"),
    "sure, wrong": ("confidently_wrong_fraction", ".3f"),
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
_PROBABILITIES: Columns = {
    **_SEED,
    "sure, right from": ("sure_and_right_at_step", "d"),
    "lowest since": ("truth_probability_lowest_once_sure", ".2f"),
    "tracked": ("truth_tracked_fraction", ".3f"),
    "mean": ("truth_probability_mean", ".2f"),
    "log score": ("log_score_mean", ".2f"),
    "Brier score": ("brier_mean", ".2f"),
}
MORE_TABLES = {
    "probability of the true place": _PROBABILITIES,
    "share of the steps in each state": _STATES,
}


def table_rows(runs: Sequence[Result], columns: Columns) -> list[list[str]]:
    return [[_shown(run[key], form) for key, form in columns.values()] for run in runs]


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
