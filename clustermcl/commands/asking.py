"""The commands that ask a running system, and print or save what it answers."""

import logging
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from clustermcl.commands.options import AsJson, Assignments, SettingsFile
from process_runtime.settings_file import load_settings


def pose(
    as_json: AsJson = False, settings_file: SettingsFile = None, assignments: Assignments = None
) -> None:
    """Where the robot is now, how surely, and how old the data is."""
    from clustermcl.questions import print_pose  # noqa: PLC0415 - see the package

    print_pose(load_settings(settings_file, assignments or ()), as_json=as_json)


def hypotheses(
    above: Annotated[
        float, typer.Option(min=0.0, max=1.0, metavar="P", help="Only places above P.")
    ] = 0.0,
    as_json: AsJson = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """All places where the robot may be, with their probabilities."""
    from clustermcl.questions import print_hypotheses  # noqa: PLC0415 - see the package

    settings = load_settings(settings_file, assignments or ())
    print_hypotheses(settings, above=above, as_json=as_json)


def events(
    follow: Annotated[
        bool, typer.Option("--follow", help="And each from now on, until Ctrl-C.")
    ] = False,
    as_json: AsJson = False,
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Which clusters and searches began and ended of late, and why."""
    from clustermcl.questions import follow_events, print_events  # noqa: PLC0415 - see the package

    settings = load_settings(settings_file, assignments or ())
    if follow:
        _until_interrupted(lambda: follow_events(settings, as_json=as_json))
    else:
        print_events(settings, as_json=as_json)


def status(
    as_json: AsJson = False, settings_file: SettingsFile = None, assignments: Assignments = None
) -> None:
    """How the system is: steps, workers, what was dropped or refused."""
    from clustermcl.questions import print_status  # noqa: PLC0415 - see the package

    print_status(load_settings(settings_file, assignments or ()), as_json=as_json)


def watch(
    as_json: AsJson = False, settings_file: SettingsFile = None, assignments: Assignments = None
) -> None:
    """Every belief from now on, until Ctrl-C."""
    from clustermcl.questions import watch as stream  # noqa: PLC0415 - see the package

    _until_interrupted(
        lambda: stream(load_settings(settings_file, assignments or ()), as_json=as_json)
    )


def snapshot(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="NAME.png, or a page: NAME.html.")],
    settings_file: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Save what is to be seen now: a picture, or a page that needs no server."""
    from clustermcl.snapshot import save_snapshot  # noqa: PLC0415 - see the package

    save_snapshot(file, load_settings(settings_file, assignments or ()))


def _until_interrupted(action: Callable[[], None]) -> None:
    """Run what has no end of its own; Ctrl-C is how a person ends it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        action()
    except KeyboardInterrupt:
        logging.getLogger(__name__).debug("interrupted")
