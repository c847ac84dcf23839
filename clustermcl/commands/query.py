"""The commands that query a running system, and print or save the answer."""

import logging
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from clustermcl.commands.options import AsJson, client_command
from process_runtime.settings import Settings

EXIT_NO_POSE = 4


@client_command
def pose(settings: Settings, as_json: AsJson = False) -> None:
    """Print the robot's pose, its uncertainty, and the age of the data.

    Exit code 4 if the pose is not safe to drive by: stale, blind, lost, or not known yet.
    """
    from clustermcl.queries import print_pose  # noqa: PLC0415 - see the package

    if not print_pose(settings, as_json=as_json):
        sys.exit(EXIT_NO_POSE)


@client_command
def hypotheses(
    settings: Settings,
    above: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="P", help="Only places above P.")
    ] = 0.0,
    as_json: AsJson = False,
) -> None:
    """Print all places where the robot may be, with probabilities."""
    from clustermcl.queries import print_hypotheses  # noqa: PLC0415 - see the package

    print_hypotheses(settings, above=above, as_json=as_json)


@client_command
def events(
    settings: Settings,
    follow: Annotated[
        bool, typer.Option("--follow", help="Also print new events, until Ctrl-C.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Print which clusters and searches began and ended, and why."""
    from clustermcl.queries import follow_events, print_events  # noqa: PLC0415 - see the package

    if follow:
        _until_interrupted(lambda: follow_events(settings, as_json=as_json))
    else:
        print_events(settings, as_json=as_json)


@client_command
def status(settings: Settings, as_json: AsJson = False) -> None:
    """Print steps, workers, and counts of dropped data."""
    from clustermcl.queries import print_status  # noqa: PLC0415 - see the package

    print_status(settings, as_json=as_json)


@client_command
def watch(settings: Settings, as_json: AsJson = False) -> None:
    """Print every new belief, until Ctrl-C."""
    from clustermcl.queries import watch as stream  # noqa: PLC0415 - see the package

    _until_interrupted(lambda: stream(settings, as_json=as_json))


@client_command
def snapshot(
    settings: Settings,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="NAME.png, or a page: NAME.html.")],
) -> None:
    """Save the current state as a picture or a standalone page."""
    from clustermcl.snapshot import save_snapshot  # noqa: PLC0415 - see the package

    save_snapshot(file, settings)


def _until_interrupted(action: Callable[[], None]) -> None:
    """Run an endless action until Ctrl-C."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        action()
    except KeyboardInterrupt:
        logging.getLogger(__name__).debug("interrupted")
