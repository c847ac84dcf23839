"""`clustermcl experiments`: the options of the command."""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

MOST_RUNS, MOST_JOBS = 10_000, 256
"""What is asked beyond is a slip of the keys."""


def experiments(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME]...", help="Experiments to run; all, if none is named."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1, max=MOST_RUNS, help="Runs of each experiment; left out: its own number."
        ),
    ] = None,
    first_seed: Annotated[int, typer.Option(min=0, help="The first seed; others follow.")] = 0,
    all_seeds: Annotated[
        bool,
        typer.Option(
            "--all-seeds",
            help="As many runs as the targets are stated for; takes well over half an hour.",
        ),
    ] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="Two short runs of each, to see that all works.")
    ] = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for results and plots.")] = Path(
        "experiments"
    ),
    report: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The report; left out: DIR/experiments.md."),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of recordings; left out: $CLUSTERMCL_DATA."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_JOBS, help="Processes; left out: one for each core."),
    ] = None,
    no_plots: Annotated[bool, typer.Option("--no-plots", help="Draw no plots.")] = False,
    settings_file: Annotated[
        Path | None, typer.Option("--settings", metavar="FILE", help="Settings file (TOML).")
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="A setting, over the file's; may be repeated."
        ),
    ] = None,
    list_only: Annotated[
        bool, typer.Option("--list", help="List the experiments and run nothing.")
    ] = False,
) -> None:
    """Run the experiments, and report each figure and its target.

    Ordinary MCL runs beside Cluster-MCL. Ctrl-C ends it; what has ended by then is reported.
    """
    # What follows takes a second to import; other commands do without.
    from rich.console import Console  # noqa: PLC0415 - see above

    from evaluation.experiments.listing import listing  # noqa: PLC0415 - see above
    from evaluation.experiments.plan import Extent, Given  # noqa: PLC0415 - see above
    from evaluation.experiments.run import (  # noqa: PLC0415 - see above
        Options,
        available,
        run_experiments,
    )
    from process_runtime.stop import stop_on_signals  # noqa: PLC0415 - see above

    console = Console(emoji=False)
    if list_only:
        console.print(listing(*available(data)))
        return
    options = Options(
        names=names or (),
        extent=Extent(seeds=seeds, first_seed=first_seed, all_asked=all_seeds, quick=quick),
        out=out,
        report=report,
        data=data,
        jobs=jobs,
        given=Given(settings_file, assignments or ()),
        plots=not no_plots,
        command=shlex.join(["clustermcl", *sys.argv[1:]]),
    )
    stop = stop_on_signals(exit_after_s=900.0)  # on a busy machine, pictures take minutes
    written = run_experiments(options, stop, console)
    text = f"the report is {written}" if written else "no run had ended yet: nothing is reported"
    console.print(text, highlight=False, soft_wrap=True, markup=False)
    stop.check()
