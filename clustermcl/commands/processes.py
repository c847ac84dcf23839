"""The commands that become another program: a router, workers, or the page."""

import os
from pathlib import Path
from typing import Annotated

import typer

from clustermcl.commands import options as opt
from clustermcl.protocol.errors import SettingsError
from clustermcl.runtime.supervisor import python_module


@opt.given_command("router")
def router(
    given: opt.Given,
    config: Annotated[Path | None, opt.option("Zenoh configuration (JSON5).", "FILE")] = None,
) -> None:
    """Run only the router, for several robots."""
    become("link.router", given, *([] if config is None else ["--config", str(config)]))


@opt.given_command("robot", "router")
def worker(
    given: opt.Given,
    name: Annotated[str, opt.option("Unique name of its processes.", "NAME")],
    count: Annotated[int | None, opt.option("Number of them (worker.count).", min=1)] = None,
    fleet: Annotated[Path | None, opt.option("Serve the robots of its files.", "FOLDER")] = None,
) -> None:
    """Run more workers for a robot or a fleet, here or elsewhere."""
    if fleet is not None and any(each.startswith("robot.name=") for each in given.assignments):
        raise SettingsError("--fleet: its files name the robots; leave out --robot")
    words = ["--name", name, *([] if count is None else ["--count", str(count)])]
    words += [] if fleet is None else ["--fleet", str(fleet)]
    become("worker", given, *words)


def become(module: str, given: opt.Given, *arguments: str) -> None:
    """Replace this process by another program, which then receives the signals."""
    command = [*python_module(f"clustermcl.{module}"), *arguments, *given.words()]
    os.execv(command[0], command)


@opt.given_command("robot", "router")
def view(
    given: opt.Given,
    context: typer.Context,
    recording: Annotated[
        Path | None, opt.argument("[FILE.mcap|FOLDER]", "A recorded run, not a running system.")
    ] = None,
    save: Annotated[
        Path | None, opt.option("Write the run as one page, or as .rrd for Rerun.", "FILE.html")
    ] = None,
    listen: opt.Listen = None,
    allow_commands: opt.AllowCommands = False,
) -> None:
    """Show a running system or a recorded run in the browser."""
    opt.refuse_without("a recording", recording, save=save)
    if recording is None:
        words = ["--allow-commands"] if allow_commands else []
        become("view", given, "--listen", listen or opt.HERE, *words)
        return
    without = ("robot", "router", "settings_file", "assignments", "allow_commands")
    opt.refuse_given(context, "a recorded run", *without)
    if save is not None:
        opt.refuse_given(context, "a saved page", "listen")
    from clustermcl.view.admission import parsed_address  # noqa: PLC0415 - see the package
    from clustermcl.view.recorded_run import view_recording  # noqa: PLC0415 - see the package

    view_recording(recording, parsed_address(listen or opt.HERE), save)
