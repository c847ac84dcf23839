"""`clustermcl soak`: the options of the command."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from process_runtime.output_files import (
    check_output_file,
    check_output_folder,
    write_output_file,
)
from process_runtime.settings_file import load_settings
from process_runtime.stop import stop_on_signals
from protocol.errors import SettingsError

EXIT_BROKEN = 1
_END_WITHIN_S = 60.0


def soak(
    minutes: Annotated[
        float, typer.Option(min=0.1, help="How long, from when all robots know their places.")
    ] = 10.0,
    robots: Annotated[int, typer.Option(min=1, help="Robots behind one router.")] = 1,
    workers: Annotated[
        int, typer.Option(min=1, help="Worker processes of each: for 8 clusters, and 2 standby.")
    ] = 10,
    coordinators: Annotated[
        int, typer.Option(min=1, help="Of each; one acts, the others stand by.")
    ] = 1,
    rate_hz: Annotated[
        float, typer.Option(min=0.1, help="Scans a second of each; every one is a step.")
    ] = 10.0,
    chaos: Annotated[
        bool, typer.Option("--chaos", help="Kill, freeze and confuse processes meanwhile.")
    ] = False,
    fault_every_s: Annotated[
        float, typer.Option(min=1.0, help="Mean distance of two faults [s].")
    ] = 20.0,
    only: Annotated[
        list[str] | None,
        typer.Option(metavar="FAULT", help="With --chaos, only such as 'worker killed'; repeat."),
    ] = None,
    world: Annotated[
        str, typer.Option(metavar="NAME", help="Simulated world; eight_rooms are all alike.")
    ] = "eight_rooms",
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of robots and faults.")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Write all figures there.")
    ] = None,
    logs: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the processes' logs there.")
    ] = None,
    settings_file: Annotated[
        Path | None, typer.Option("--settings", metavar="FILE", help="Settings file (TOML).")
    ] = None,
    assignments: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="A setting, over the file's; may be repeated."
        ),
    ] = None,
) -> None:
    """Run everything on simulated robots for long, with faults, and check what is promised.

    Exit code 1 if a promise was broken. Ctrl-C ends it with what was seen so far.
    """
    try:
        import psutil  # noqa: F401, PLC0415 - asked for before anything else is imported
    except ModuleNotFoundError as error:
        raise SettingsError(
            key="soak",
            problem="the soak test needs psutil, which is not installed: "
            "pip install 'clustermcl[soak]'",
        ) from error
    # What follows takes a second to import; other commands do without.
    from rich.console import Console  # noqa: PLC0415 - see above

    from clustermcl.as_json import dumped  # noqa: PLC0415 - see above
    from soak_test.options import SoakOptions  # noqa: PLC0415 - see above
    from soak_test.progress import ConsoleProgress  # noqa: PLC0415 - see above
    from soak_test.report import as_object, print_result  # noqa: PLC0415 - see above
    from soak_test.run import run_soak  # noqa: PLC0415 - see above
    from soak_test.schedule import Kind  # noqa: PLC0415 - see above

    if unknown := set(only or ()) - set(Kind):
        known = ", ".join(Kind)
        problem = f"--only {unknown.pop()!r} is no fault; known are: {known}"
        raise SettingsError(key="--only", problem=problem)
    if json_file is not None:
        check_output_file(json_file)
    if logs is not None:
        check_output_folder(logs)
    options = SoakOptions(
        minutes=minutes,
        robots=robots,
        coordinators=coordinators,
        rate_hz=rate_hz,
        world=world,
        chaos=chaos,
        fault_every_s=fault_every_s,
        only=tuple(kind for kind in Kind if kind in (only or ())),
        json_file=json_file,
        logs=logs,
    )
    given = [
        "bridge.source=zenoh", "bridge.gate_distance_m=0", "bridge.gate_turn_rad=0",
        "belief.max_clusters=8", f"worker.count={workers}",
    ]  # fmt: skip
    given += [f"seed={seed}"] if seed is not None else []
    settings = load_settings(settings_file, [*given, *(assignments or ())])
    stop = stop_on_signals(exit_after_s=_END_WITHIN_S)
    console = Console(emoji=False)
    if not console.is_terminal:
        console.width = 132
    progress = ConsoleProgress(console, minutes)
    try:
        result = run_soak(options, settings, stop, progress)
    finally:
        progress.close()
    print_result(result, console)
    if json_file is not None:
        write_output_file(json_file, dumped(as_object(result)) + "\n")
    if result.broken:
        sys.exit(EXIT_BROKEN)
    stop.check()
