"""The commands that become another program: a router, workers, or the page."""

import os
from pathlib import Path
from typing import Annotated

import typer

from clustermcl.commands import options as common
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.settings import ROBOT_VARIABLE
from clustermcl.runtime.supervisor import python_module


@common.given_command("router")
def router(
    given: common.Given,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Zenoh configuration (JSON5), used unchanged."),
    ] = None,
) -> None:
    """Run only the router, for several robots."""
    become("link.router", given, *([] if config is None else ["--config", str(config)]))


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
    """Run more workers for a robot or a fleet, here or elsewhere."""
    if fleet is not None and any(each.startswith("robot.name=") for each in given.assignments):
        raise SettingsError("--fleet: its files name the robots; leave out --robot")
    words = ["--name", name, *([] if count is None else ["--count", str(count)])]
    words += [] if fleet is None else ["--fleet", str(fleet)]
    become("worker", given, *words)


def become(module: str, given: common.Given, *arguments: str) -> None:
    """Replace this process by another program, which then receives the signals."""
    command = [*python_module(f"clustermcl.{module}"), *arguments, *given.words()]
    os.execv(command[0], command)


@common.given_command("router")
def view(
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
        become("view", given, "--listen", listen or common.HERE, *words)
        return
    from clustermcl.view.admission import parsed_address  # noqa: PLC0415 - see the package
    from clustermcl.view.recorded_run import view_recording  # noqa: PLC0415 - see the package

    address = parsed_address(listen or common.HERE)
    view_recording(recording, address, map_file, save_file, open_browser=open_browser)
