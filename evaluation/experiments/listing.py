"""The experiments as a table for people."""

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table

from evaluation.experiments.case import Case


def listing(cases: Sequence[Case], left_out: Sequence[str]) -> RenderableType:
    """All experiments with their runs and estimated times, and what is left out."""
    table = Table(expand=False)
    table.add_column("experiment", no_wrap=True)
    table.add_column("what")
    table.add_column("role", no_wrap=True)
    for name in ("runs", "algorithms", "core min"):
        table.add_column(name, justify="right")
    for case in cases:
        asked = case.asked_seeds or case.seeds
        runs = str(case.seeds) if asked <= case.seeds else f"{case.seeds} of {asked}"
        minutes = case.seeds * sum(case.run_ms(a) for a in case.algorithms) / 60e3
        count = str(len(case.algorithms))
        table.add_row(case.name, case.title, case.role, runs, count, f"{minutes:.1f}")
    return Group(table, *left_out)
