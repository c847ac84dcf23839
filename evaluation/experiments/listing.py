"""The experiments as a table for people."""

from collections.abc import Sequence

from rich.console import Group, RenderableType
from rich.table import Table

from evaluation.experiments.case import ALGORITHMS, Case


def listing(cases: Sequence[Case], left_out: Sequence[str]) -> RenderableType:
    """All experiments with their runs and estimated times, and what is left out."""
    table = Table(expand=False)
    table.add_column("experiment", no_wrap=True)
    table.add_column("what")
    for name in ("runs", "ordinary", "core min"):
        table.add_column(name, justify="right")
    for case in cases:
        asked = case.asked_seeds or case.seeds
        runs = str(case.seeds) if asked <= case.seeds else f"{case.seeds} of {asked}"
        minutes = sum(case.seed_count(a) * case.run_ms(a) for a in ALGORITHMS) / 60e3
        table.add_row(case.name, case.title, runs, str(case.ordinary_seeds), f"{minutes:.1f}")
    return Group(table, *left_out)
