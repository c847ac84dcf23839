"""Run experiments into a table, and summarise the table.

python -m benchmarks.experiments [NAME...] [--output FILE]
python -m benchmarks.experiments --summary [--output FILE] [--tables FOLDER]
"""

import os
import sys
from pathlib import Path
from typing import Annotated

import pandas as pd
import typer
from rich.console import Console
from rich.progress import track

from benchmarks.experiments.case import algorithm_named
from benchmarks.experiments.catalogue import all_cases
from benchmarks.experiments.run_table import RunTable, key_of, tasks_of
from benchmarks.experiments.summary import behind, over_all, read_table, reliability, rivals, starts
from benchmarks.experiments.summary import summary as table_summary
from benchmarks.experiments.task import run_task
from clustermcl.commands.evaluate import MOST_JOBS, MOST_RUNS
from clustermcl.commands.options import Assignments, SettingsFile
from clustermcl.evaluation.run import in_parallel
from clustermcl.jobs.warm_up import compile_kernels
from clustermcl.protocol.errors import ClusterMclError, SettingsError
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.stop import StoppedError, stop_on_signals

app = typer.Typer(add_completion=False)


@app.command()
def experiments(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="Experiments; all, if none is named."),
    ] = None,
    output: Annotated[
        Path, typer.Option(metavar="FILE", help="Table of runs, continued if it exists (CSV).")
    ] = Path("experiments.csv"),
    summary: Annotated[
        bool, typer.Option("--summary", help="Summarise the table and run nothing.")
    ] = False,
    tables: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="With --summary: write tables there."),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, max=MOST_RUNS, help="Runs of each experiment.")
    ] = None,
    first_seed: Annotated[int, typer.Option(min=0, help="The first seed.")] = 0,
    algorithms: Annotated[
        list[str] | None,
        typer.Option("--algorithm", metavar="NAME", help="Instead of each experiment's own."),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of recordings; left out: $CLUSTERMCL_DATA."),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=MOST_JOBS, help="Processes; left out: one a core.")
    ] = None,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
    list_only: Annotated[
        bool, typer.Option("--list", help="List the experiments and run nothing.")
    ] = False,
) -> None:
    """Run experiments, next to ordinary MCL, into a table with a row for each run.

    Ctrl-C ends it; the same command continues it.
    """
    console = Console(emoji=False, markup=False, highlight=False, soft_wrap=True)
    if summary:
        runs = read_table(output)
        each = table_summary(runs)
        for table in (each, over_all(each), behind(each)):
            console.print(_csv(table))
        if tables is not None:
            tables.mkdir(parents=True, exist_ok=True)
            for name, table in (
                ("summary", each), ("reliability", reliability(runs)),
                ("starts", starts(runs)), ("rivals", rivals(runs)),
            ):  # fmt: skip
                (tables / f"{name}.csv").write_text(_csv(table), encoding="utf-8")
        return
    known = {case.name: case for case in all_cases(data)}
    for name in names or ():
        if name not in known:
            problem = f"no experiment {name!r}; the experiments are {', '.join(known)}"
            raise SettingsError(key="NAME", problem=problem)
    cases = [known[name] for name in names or known]
    if list_only:
        for case in cases:
            console.print(f"{case.name:22} {case.seeds:3} seeds  {case.role:10} {case.title}")
        return
    span = None if seeds is None else range(first_seed, first_seed + seeds)
    chosen = [algorithm_named(name) for name in algorithms or ()]
    settings = load_settings(settings_file, assignments or ())
    table = RunTable(output, settings)
    tasks = [
        task for task in tasks_of(cases, chosen, span, settings) if key_of(task) not in table.done
    ]
    compile_kernels(settings.sensor)
    stop = stop_on_signals(exit_after_s=5.0)
    done = in_parallel(run_task, tasks, jobs or os.cpu_count() or 1, stop)
    shown = Console(stderr=True)
    for index, finished in track(done, "runs", len(tasks), console=shown, transient=True):
        table.append(tasks[index], finished)
    console.print(f"{len(table.done)} runs are in {output}; --summary summarises them")
    stop.check()


def _csv(table: pd.DataFrame) -> str:
    return table.to_csv(index=False, float_format="%.5g")


if __name__ == "__main__":
    try:
        app()
    except StoppedError:
        sys.exit(130)
    except ClusterMclError as error:
        sys.exit(f"benchmarks.experiments: {error}")
