"""The commands about recordings, maps and settings."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from clustermcl.commands import options as common
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import ROBOT_VARIABLE, Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.stop import stop_on_signals

EXIT_DIFFERENT = 1
MOST_RUNS, MOST_JOBS = 10_000, 256
"""Limits against typing errors."""
MOST_STEPS = 100_000
"""Limit for an evaluated run, 20 km of driving: all measurements are kept in memory."""


@common.recording_command
def evaluate(
    settings: Settings,
    recording: Annotated[
        str, typer.Argument(metavar="RECORDING", help="Recording, sim:WORLD or sim:MAP.yaml.")
    ],
    map_file: Annotated[
        str | None, typer.Option("--map", metavar="FILE", help="Map of the recording.")
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE.tum", help="Ground truth to compare with.")
    ] = None,
    seeds: Annotated[
        int,
        typer.Option(min=1, max=MOST_RUNS, help="Number of runs; the first has the seed set."),
    ] = 1,
    starts: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_RUNS, help="Number of runs from different steps, or seeds."),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_STEPS, help="Most steps: 300 if simulated, 60 with --starts."),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, max=MOST_JOBS, help="Parallel runs; by default one per core."),
    ] = None,
    as_json: common.AsJson = False,
    output: common.Output = None,
    tum: Annotated[
        Path | None,
        typer.Option("--tum", metavar="FILE.tum", help="Write the estimates of one run for evo."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE.png", help="Draw one run: path, probability, error."),
    ] = None,
    floor: common.Floor = "",
) -> None:
    """Localize in one process, and measure the accuracy.

    Runs without Zenoh, as fast as possible.
    """
    from clustermcl.evaluation.evaluate import run_evaluate  # noqa: PLC0415 - see the package

    run_evaluate(
        settings,
        recording=recording,
        map_file=map_file,
        reference=reference,
        seeds=seeds,
        starts=starts,
        steps=steps,
        jobs=jobs,
        as_json=as_json,
        output=output,
        tum=tum,
        plot=plot,
        floor=floor,
    )


@common.recording_command
def check(
    settings: Settings,
    map_file: Annotated[str, typer.Argument(metavar="MAP", help="Map file.")],
    recording: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Recording of a robot in that map.")
    ] = None,
    laser_range_m: Annotated[
        float, typer.Option("--range", min=0.5, metavar="M", help="Range of the laser [m].")
    ] = 12.0,
    places: Annotated[int, typer.Option(min=1, max=1_000, help="Number of tested places.")] = 24,
    report_file: Annotated[
        Path | None,
        typer.Option("--report", metavar="FILE.png", help="Draw the report on the map."),
    ] = None,
    as_json: common.AsJson = False,
) -> None:
    """Check whether a map is suitable, and which places look alike.

    With a recording, also check whether it matches the map.
    """
    from clustermcl.commands.check import run_check  # noqa: PLC0415 - see the package

    run_check(
        map_file,
        recording,
        settings,
        laser_range_m=laser_range_m,
        places=places,
        as_json=as_json,
        report_file=report_file,
    )


@common.settings_command("router", *common.OF_BAGS)
def changes(
    settings: Settings,
    recording: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Recording of a robot, in place of a running system."),
    ] = None,
    robots: Annotated[
        list[str] | None,
        typer.Option("--robot", metavar="NAME", envvar=ROBOT_VARIABLE, help="May be repeated."),
    ] = None,
    map_file: Annotated[
        str | None, typer.Option("--map", metavar="FILE", help="Map of the recording.")
    ] = None,
    since: Annotated[
        str | None, typer.Option(metavar="7d", help="Only what was seen in this time: s, m, h, d.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE.yaml", help="Write the map with the changes.")
    ] = None,
    as_json: common.AsJson = False,
) -> None:
    """Print what has changed in the building since it was mapped, and write a new map.

    The old map and a picture are written beside the new one. Of several robots, the newest sighting
    of each cell counts.
    """
    from clustermcl.commands.changes import run_changes  # noqa: PLC0415 - see the package

    run_changes(
        settings,
        recording=recording,
        map_file=map_file,
        robots=robots or [],
        since_s=None if since is None else common.seconds_of("--since", since),
        output=output,
        as_json=as_json,
    )


@common.client_command
def record(
    settings: Settings,
    file: Annotated[
        Path, typer.Argument(metavar="FILE.mcap", help="An existing file is replaced.")
    ],
) -> None:
    """Record map, scans, odometry and beliefs, until Ctrl-C."""
    from clustermcl.commands.record import run_record  # noqa: PLC0415 - see the package

    steps = run_record(settings, file)
    typer.echo(f"{file}: {steps} steps")


@common.client_command
def record_landmarks(
    settings: Settings,
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE.yaml", help="Landmarks are added to an existing file."),
    ],
) -> None:
    """Measure landmarks that the localized robot sees, until Ctrl-C."""
    from clustermcl.commands.record_landmarks import run_record_landmarks  # noqa: PLC0415 - see the package

    typer.echo("\n".join(run_record_landmarks(settings, file, stop_on_signals())))


def replay(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="A robot's flight recording, or a file of it."),
    ],
    first: Annotated[
        str | None, typer.Option("--from", metavar="WHEN", help="Print from this step or time on.")
    ] = None,
    last: Annotated[
        str | None, typer.Option("--to", metavar="WHEN", help="Print up to this step or time.")
    ] = None,
    at: Annotated[
        str | None, typer.Option(metavar="WHEN", help="Print 5 seconds, or steps, around it.")
    ] = None,
    above: common.Above = 0.0,
    why: Annotated[
        str | None,
        typer.Option(metavar="PLACE", help="Print why this place (c7, or elsewhere) rose or fell."),
    ] = None,
) -> None:
    """Recompute a flight recording, and print what happened.

    `--why` also reads a run that was recorded otherwise, and recomputes nothing. WHEN is a
    step, or a local time: 200, 11:45:51, or '2026-11-20 11:45:51'. Exit code 1 if a belief
    differs from the recorded one.
    """
    from clustermcl.commands.replay import Shown, parsed_moment, print_replay  # noqa: PLC0415 - see the package
    from clustermcl.commands.why import parsed_place, print_why  # noqa: PLC0415

    if at and (first or last):
        raise SettingsError("--at with --from or --to: leave one out")
    shown = Shown(
        first=parsed_moment("--from", first),
        last=parsed_moment("--to", last),
        around=parsed_moment("--at", at),
        above=above,
    )
    if why is not None:
        print_why(folder, parsed_place(why), shown)
        return
    sys.exit(0 if print_replay(folder, shown) else EXIT_DIFFERENT)


def settings(
    from_nav2: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Convert a nav2_params.yaml.")
    ] = None,
    show_all: Annotated[
        bool, typer.Option("--all", help="Also print constants of the filter and the service.")
    ] = False,
    settings_file: common.SettingsFile = None,
    assignments: common.Assignments = None,
) -> None:
    """Print the settings with default, unit and meaning, as TOML.

    The output is a valid file for --settings.
    """
    from clustermcl.runtime.settings_table import (  # noqa: PLC0415 - see the package
        EVERYDAY,
        TABLE,
        settings_as_toml,
    )

    values: dict[str, Any] = {}
    if from_nav2 is not None:
        from clustermcl.ros2.nav2_params import read_nav2_params  # noqa: PLC0415 - see the package

        values, notes = read_nav2_params(from_nav2)
        for line in notes:
            typer.echo(f"# {line}")
    chosen = load_settings(
        settings_file, assignments or (), beneath=values, beneath_from=str(from_nav2)
    )
    if not show_all:
        count = f"{len(EVERYDAY)} of {len(TABLE)} settings"
        typer.echo(f"# {count}; clustermcl settings --all prints all.\n")
    typer.echo(settings_as_toml(chosen, None if show_all else EVERYDAY), nl=False)
