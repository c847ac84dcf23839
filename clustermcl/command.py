"""The command a person types: the table of all commands, and what ends each."""

import sys
from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated

import typer

from clustermcl.commands import asking, recordings, running, telling
from clustermcl.loudness import LoudCommands, set_loudness
from evaluation.experiments.command import experiments
from process_runtime.main import EXIT_ERROR
from process_runtime.output import written_output
from process_runtime.stop import StoppedError
from protocol.errors import ClusterMclError

EXIT_INTERRUPTED = 130

app = typer.Typer(
    help="Global localization that keeps every possible place: Cluster-MCL over Zenoh.",
    cls=LoudCommands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
_NUMBERS_MAY_BE_NEGATIVE = {"ignore_unknown_options": True}
COMMANDS: dict[str, Callable[..., None]] = {
    "experiments": experiments,
    "demo": running.demo,
    "up": running.up,
    "ros2": running.ros2,
    "evaluate": recordings.evaluate,
    "check": recordings.check,
    "pose": asking.pose,
    "hypotheses": asking.hypotheses,
    "events": asking.events,
    "status": asking.status,
    "watch": asking.watch,
    "view": running.serve_view,
    "snapshot": asking.snapshot,
    "set-pose": telling.set_pose,
    "relocalize": telling.relocalize,
    "update": telling.update,
    "kidnap": telling.kidnap,
    "record": recordings.record,
    "replay": recordings.replay,
    "settings": recordings.settings,
}
"""In the order of the help."""
for _name, _command in COMMANDS.items():
    app.command(_name, context_settings=_NUMBERS_MAY_BE_NEGATIVE if _name == "set-pose" else None)(
        _command
    )


def _say_version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"clustermcl {version('clustermcl')}\n")
        raise typer.Exit


@app.callback()
def _common(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_say_version, is_eager=True, help="Say it and exit."),
    ] = False,
) -> None:
    """Take what stands before the command."""


def main() -> None:
    """Run the command; errors that a person can mend are one line and exit code 2."""
    set_loudness()
    try:
        with written_output():
            app()
    except StoppedError:
        sys.exit(EXIT_INTERRUPTED)
    except ClusterMclError as error:
        sys.stderr.write(f"clustermcl: {' '.join(str(error).split())}\n")
        sys.exit(EXIT_ERROR)
    except BrokenPipeError:  # the reader of a pipe has seen enough
        sys.stderr.close()
        sys.exit(EXIT_INTERRUPTED)
