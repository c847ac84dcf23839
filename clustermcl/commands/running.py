"""The commands that start processes and run until Ctrl-C."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from clustermcl import completion
from clustermcl.commands.options import (
    HERE,
    AllowCommands,
    AsJson,
    Assignments,
    BaseFrame,
    Listen,
    OdomFrame,
    OdomTopic,
    RecordFile,
    ScanTopic,
    SettingsFile,
    of_bag,
)
from clustermcl.loudness import log_settings
from process_runtime.settings_file import load_settings


def demo(
    recording: Annotated[
        str | None,
        typer.Option(
            metavar="FILE",
            help="Recording, or sim:WORLD, or sim:MAP.yaml.",
            autocompletion=completion.recordings,
        ),
    ] = None,
    map_file: Annotated[
        str | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="Map of the recording; without one, a simulated robot drives in this map.",
        ),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(metavar="FILE.tum", help="True trajectory, to compare with.")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Worker processes.")] = None,
    rate: Annotated[
        float | None,
        typer.Option(min=0.0, help="1: real time, 2: twice as fast, 0: as the workers follow."),
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Steps of a simulated robot.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of all random numbers.")] = None,
    scan_topic: ScanTopic = "",
    odom_topic: OdomTopic = "",
    odom_frame: OdomFrame = "",
    base_frame: BaseFrame = "",
    view: Annotated[
        bool, typer.Option("--view", help="Serve a page that draws it; runs on until Ctrl-C.")
    ] = False,
    drive: Annotated[
        bool, typer.Option("--drive", help="With --view: drive the robot with the arrow keys.")
    ] = False,
    listen: Listen = HERE,
    record_file: RecordFile = None,
    as_json: AsJson = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Start everything on this machine and watch it localize; without options, a simulation."""
    from clustermcl.demo import run_demo  # noqa: PLC0415 - see the package
    from clustermcl.demo_show import DemoOptions  # noqa: PLC0415 - see the package

    given = [*log_settings(), *(assignments or ())]
    given += of_bag(scan_topic, odom_topic, odom_frame, base_frame)
    given += [f"worker.count={workers}"] if workers else []
    given += [f"seed={seed}"] if seed is not None else []
    options = DemoOptions(
        recording=recording,
        map_file=map_file,
        reference=reference,
        rate=rate,
        steps=steps,
        view_at=listen if view else None,
        record=record_file,
        by_hand=drive,
        as_json=as_json,
    )
    run_demo(options, load_settings(settings_file, given))


def up(
    nav2_params: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="AMCL's parameters, from a nav2_params.yaml."),
    ] = None,
    view: Annotated[bool, typer.Option("--view", help="Serve a page that draws it, too.")] = False,
    listen: Listen = HERE,
    allow_commands: AllowCommands = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Run everything on this machine, in the foreground, until Ctrl-C."""
    from clustermcl.nav2 import settings_with_nav2  # noqa: PLC0415 - see the package
    from clustermcl.up import run_up  # noqa: PLC0415 - see the package

    given = [*log_settings(), *(assignments or ())]
    chosen, notes = settings_with_nav2(nav2_params, settings_file, given)
    for line in notes:
        sys.stderr.write(f"clustermcl: {line}\n")
    run_up(chosen, view_at=listen if view else None, allow_commands=allow_commands)


def ros2(settings_file: SettingsFile = None, assignments: Assignments = None) -> None:
    """Stand in for nav2's AMCL on a ROS 2 robot over rmw_zenoh, until Ctrl-C."""
    from process_runtime.stop import stop_on_signals  # noqa: PLC0415 - see the package
    from ros2_bridge.process import serve  # noqa: PLC0415 - see the package

    chosen = load_settings(settings_file, [*log_settings(), *(assignments or ())])
    serve(chosen, "ros2_bridge", stop_on_signals())


def serve_view(
    recording: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE.mcap|FOLDER]",
            help="A finished run, of 'record' or of the flight recorder, instead of a live one.",
        ),
    ] = None,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Map of the recording.")
    ] = None,
    open_browser: Annotated[
        bool, typer.Option("--open", help="Open the page in this machine's browser.")
    ] = False,
    listen: Listen = HERE,
    allow_commands: AllowCommands = False,
    certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PEM: serve the page by HTTPS.")
    ] = None,
    private_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PEM, of the certificate.")
    ] = None,
    robots: Annotated[
        list[str] | None,
        typer.Option("--robot", metavar="NAME", help="Instead of robot.name; may be repeated."),
    ] = None,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Serve a page that draws all places where the robot may be, live, until Ctrl-C."""
    from clustermcl.view import ViewOptions, run_view  # noqa: PLC0415 - see the package

    options = ViewOptions(
        listen=listen,
        allow_commands=allow_commands,
        open_browser=open_browser,
        certificate=certificate,
        private_key=private_key,
        robots=robots or (),
        recording=recording,
        map_file=map_file,
    )
    run_view(load_settings(settings_file, assignments or ()), options)
