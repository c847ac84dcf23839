"""The results of evaluated runs as JSON, CSV or Parquet, and as printed tables."""

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from process_runtime.output_files import OutputError, check_output_file, write_output_file
from protocol.errors import SettingsError

KINDS = (".json", ".csv", ".parquet")

Result = dict[str, Any]
"""One run: `seed`, `start_step` (of the recording) and the fields of `RunMeasures`."""
Columns = dict[str, tuple[str, str]]
"""The columns of a table: heading, and the key and the format of a run's measure."""


def as_json(common: Result, runs: Sequence[Result]) -> str:
    """Return JSON text with the common fields and a list of the runs."""
    return json.dumps({**common, "runs": runs}, indent=2) + "\n"


def write_results(file: Path, common: Result, runs: Sequence[Result]) -> None:
    """Write runs in the format that the file's name ends in; see `check_results_file`.

    Args:
        file: its name ends in ``.json``, ``.csv`` or ``.parquet``.
        common: fields that all runs share; columns of each row.
        runs: one row each.

    Raises:
        OutputError: the file cannot be written.
    """
    rows = [{**common, **run} for run in runs]
    match file.suffix.lower():
        case ".parquet":
            _write_parquet(file, rows)
        case ".csv":
            text = io.StringIO()
            table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
            table.writeheader()
            table.writerows(rows)
            write_output_file(file, text.getvalue())
        case _:
            write_output_file(file, as_json(common, runs))


def check_results_file(file: Path) -> None:
    """Check that results can be written to a file, before they are computed.

    Raises:
        SettingsError: the name has an unknown ending, or the library for the format is missing.
        OutputError: the file cannot be written.
    """
    if file.suffix.lower() not in KINDS:
        problem = f"--output {file}: its name has to end in {' or '.join(KINDS)}"
        raise SettingsError(key="--output", problem=problem)
    if file.suffix.lower() == ".parquet":
        _parquet()
    check_output_file(file)


def _parquet() -> tuple[Any, Any]:
    try:
        import pyarrow  # noqa: PLC0415 - an extra
        from pyarrow import parquet  # noqa: PLC0415 - an extra
    except ImportError as error:
        problem = f"--output: Parquet needs the extra 'parquet' (pip install pyarrow): {error}"
        raise SettingsError(key="--output", problem=problem) from error
    return pyarrow, parquet


def _write_parquet(file: Path, rows: Sequence[Result]) -> None:
    pyarrow, parquet = _parquet()
    try:
        parquet.write_table(pyarrow.Table.from_pylist(rows), file)
    except OSError as error:
        raise OutputError(path=file, problem=error.strerror or str(error)) from error


_SEED = {"seed": ("seed", "d"), "from": ("start_step", "d")}
POSES: Columns = {
    **_SEED,
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
    "sure at": ("sure_and_right_at_step", "d"),
    "then never under": ("truth_probability_lowest_once_sure", ".2f"),
    "tracked": ("truth_tracked_fraction", ".3f"),
    "p(truth)": ("truth_probability_mean", ".2f"),
    "log": ("log_score_mean", ".2f"),
    "brier": ("brier_mean", ".2f"),
}
MORE_TABLES = {
    "probability of the true place": _PROBABILITIES,
    "share of the steps in each state": _STATES,
}


def table_rows(runs: Sequence[Result], columns: Columns) -> list[list[str]]:
    """Return the cells of a table, one row for each run."""
    return [[_shown(run[key], form) for key, form in columns.values()] for run in runs]


def _shown(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)
