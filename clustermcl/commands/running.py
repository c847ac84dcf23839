"""The commands that start processes and run until Ctrl-C."""

import os
from pathlib import Path
from typing import Annotated

import typer

from clustermcl.commands import options as common
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import ROBOT_VARIABLE, Settings
from clustermcl.runtime.settings_file import load_settings, with_setting
from clustermcl.runtime.supervisor import python_module


@common.recording_command
def demo(
    settings: Settings,
    recording: Annotated[
        str | None, typer.Option(metavar="FILE", help="Recording, or sim:WORLD, or sim:MAP.yaml.")
    ] = None,
    map_file: Annotated[
        str | None,
        typer.Option("--map", metavar="FILE", help="Map of the recording or simulated robot."),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE.tum", help="Ground truth to compare with.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Number of worker processes.")] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=0.0, help="1: real time, 2: twice as fast, 0: as fast as possible."),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps of a simulated robot.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of all random numbers.")] = None,
    view: Annotated[
        bool, typer.Option("--view", help="Serve the live page, until Ctrl-C.")
    ] = False,
    drive: Annotated[
        bool, typer.Option("--drive", help="With --view: drive the robot with the arrow keys.")
    ] = False,
    advised: Annotated[
        bool,
        typer.Option("--advised", help="A robot that drives advised ways, and one that wanders."),
    ] = False,
    listen: common.Listen = None,
    record_file: common.RecordFile = None,
    as_json: common.AsJson = False,
) -> None:
    """Localize a simulated robot or a recording.

    All processes run on this machine, and end with the command.
    """
    common.refuse_without("--view", view, drive=drive, listen=listen)
    from clustermcl.commands.demo import DemoOptions, run_demo  # noqa: PLC0415 - see the package

    for name, value in (("worker.count", workers), ("seed", seed)):
        if value is not None:
            settings = with_setting(settings, name, value, "clustermcl demo")
    options = DemoOptions(
        recording=recording,
        map_file=map_file,
        reference=reference,
        rate=rate,
        steps=steps,
        view_at=(listen or common.HERE) if view else None,
        record=record_file,
        by_hand=drive,
        advised=advised,
        as_json=as_json,
    )
    run_demo(options, settings)


@common.given_command("robot", "router")
def up(
    given: common.Given,
    view: Annotated[bool, typer.Option("--view", help="Also serve the live page.")] = False,
    one_process: Annotated[
        bool,
        typer.Option("--one-process", help="Use one process: less memory, no fault tolerance."),
    ] = False,
    listen: common.Listen = None,
    allow_commands: common.AllowCommands = False,
) -> None:
    """Localize a robot: run all processes on this machine until Ctrl-C."""
    common.refuse_without("--view", view, listen=listen, allow_commands=allow_commands)
    if one_process:
        common.refuse_without("several processes", None, view=view)
        _become("commands.one_process", given)
    from clustermcl.commands.up import run_up  # noqa: PLC0415 - see the package

    chosen = load_settings(given.file, given.assignments)
    run_up(chosen, view_at=(listen or common.HERE) if view else None, allow_commands=allow_commands)


@common.settings_command()
def warm_up(settings: Settings) -> None:
    """Prepare this machine, so that later starts take seconds.

    Compiles the filter's kernels, and computes the likelihood field of bridge.map. Both are kept
    on disk.
    """
    from clustermcl.commands.warm_up import run_warm_up  # noqa: PLC0415 - see the package

    run_warm_up(settings)


@common.given_command("router")
def router(
    given: common.Given,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Zenoh configuration (JSON5), used unchanged."),
    ] = None,
) -> None:
    """Run only the router, for several robots."""
    _become("link.router", given, *([] if config is None else ["--config", str(config)]))


@common.given_command("robot", "router")
def worker(
    given: common.Given,
    name: Annotated[str, typer.Option(metavar="NAME", help="Unique name of its processes.")],
    count: Annotated[int | None, typer.Option(min=1, help="Number of them (worker.count).")] = None,
    fleet: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Serve the robots of its settings files."),
    ] = None,
) -> None:
    """Run more workers, on this machine or another one, for a robot or a fleet."""
    if fleet is not None and any(each.startswith("robot.name=") for each in given.assignments):
        raise SettingsError("--fleet: its files name the robots; leave out --robot")
    words = ["--name", name, *([] if count is None else ["--count", str(count)])]
    words += [] if fleet is None else ["--fleet", str(fleet)]
    _become("worker", given, *words)


def _become(module: str, given: common.Given, *arguments: str) -> None:
    """Replace this process by another program, which then receives the signals."""
    command = [*python_module(f"clustermcl.{module}"), *arguments, *given.words()]
    os.execv(command[0], command)


@common.given_command("router")
def serve_view(
    given: common.Given,
    recording: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE.mcap|FOLDER]", help="A recorded run, not a running system."),
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Map of the recording.")
    ] = None,
    save_file: Annotated[
        Path | None,
        typer.Option(
            "--save",
            metavar="FILE.html",
            help="Write the run as one page, or as .rrd for Rerun.",
        ),
    ] = None,
    open_browser: Annotated[
        bool, typer.Option("--open", help="Open the page in this machine's browser.")
    ] = False,
    listen: common.Listen = None,
    allow_commands: common.AllowCommands = False,
    robots: Annotated[
        list[str] | None,
        typer.Option("--robot", metavar="NAME", envvar=ROBOT_VARIABLE, help="May be repeated."),
    ] = None,
) -> None:
    """Show a running system or a recorded run in the browser."""
    common.refuse_without("a recording", recording, map=map_file, save=save_file)
    if recording is not None and robots:
        raise SettingsError("--robot: a recording is of one robot; leave it out")
    if recording is None:
        flags = {"--allow-commands": allow_commands, "--open": open_browser}
        words = [flag for flag, is_given in flags.items() if is_given]
        words += [word for robot in robots or () for word in ("--robot", robot)]
        _become("view", given, "--listen", listen or common.HERE, *words)
        return
    from clustermcl.view.admission import parsed_address  # noqa: PLC0415 - see the package
    from clustermcl.view.recorded_run import view_recording  # noqa: PLC0415 - see the package

    address = parsed_address(listen or common.HERE)
    view_recording(recording, address, map_file, save_file, open_browser=open_browser)
