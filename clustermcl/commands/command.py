"""The command `clustermcl`: the table of its subcommands, and the exit codes."""

import sys
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from clustermcl.commands.verbosity import set_verbosity
from clustermcl.filter.kernels.library import NoKernelsError
from clustermcl.protocol.errors import ClusterMclError, UnreachableError, escaped
from clustermcl.runtime.main import EXIT_ERROR
from clustermcl.runtime.output_files import written_output
from clustermcl.runtime.stop import StoppedError
from clustermcl.runtime.version import VERSION

EXIT_UNREACHABLE, EXIT_INTERRUPTED = 3, 130
"""Exit codes: no router or process answers; Ctrl-C, or the output's reader has ended."""

COMMANDS = {
    "Start here": {
        "demo": ("demo", "Localize a simulated robot or a recording."),
        "up": ("up", "Localize a robot: run all processes on this machine until Ctrl-C."),
        "view": ("processes", "Show a running system or a recorded run in the browser."),
    },
    "Query a running system": {
        "pose": ("live", "Print the robot's pose, its uncertainty, and reasons to doubt it."),
        "hypotheses": ("live", "Print all places where the robot may be, with probabilities."),
        "advise": ("live", "Print where to drive so that scans distinguish the possible places."),
        "watch": ("live", "Print each new belief, until Ctrl-C."),
        "events": ("live", "Print what began and ended and why, commands, and faults of sensors."),
        "status": ("live", "Print steps, workers, and counts of dropped data."),
        "snapshot": ("snapshot", "Save a picture of the map and the places."),
        "changes": ("changes", "Print what has changed in the building, and write a new map."),
    },
    "Control a running system": {
        "set-pose": ("live", "Set the robot's pose; the heading is in degrees."),
        "relocalize": ("live", "Drop all places, and search everywhere or in part of the map."),
        "update": ("live", "Use the next scan for a step, even if the robot stands still."),
    },
    "Maps, recordings, settings": {
        "check": ("check", "Check whether a map is suitable, and which places look alike."),
        "evaluate": ("evaluate", "Localize in one process, and measure the accuracy."),
        "replay": ("replay", "Recompute a flight recording, and print what happened."),
        "settings": ("settings", "Print the settings with default, unit and meaning, as TOML."),
    },
    "Single processes": {
        "warm-up": ("warm_up", "Prepare this machine, so that later starts take seconds."),
        "router": ("processes", "Run only the router, for several robots."),
        "worker": ("processes", "Run more workers for a robot or a fleet, here or elsewhere."),
    },
}  # fmt: skip
"""The subcommands by group: module, and the first line of the help."""
_MODULES = {name: module for group in COMMANDS.values() for name, (module, _) in group.items()}


class _Commands(TyperGroup):
    """The command's group, which imports a subcommand when it is used: most are slow."""

    def __init__(self, **attributes: Any) -> None:
        attributes["commands"] = dict.fromkeys(_MODULES)
        super().__init__(**attributes)

    def get_command(self, _context: Any, name: str) -> Any:
        if name not in _MODULES:
            return None
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        module = import_module(f"clustermcl.commands.{_MODULES[name]}")
        negative_numbers = {"ignore_unknown_options": name == "set-pose"}
        command = getattr(module, name.replace("-", "_"))
        alone.command(name, context_settings=negative_numbers)(command)
        return get_command(alone)

    def invoke(self, context: Any) -> Any:
        """Run a command; if its output's reader has ended, typer would exit with 1, as a bug."""
        try:
            return super().invoke(context)
        except (BrokenPipeError, SystemExit) as error:  # the latter by rich
            if BrokenPipeError in (type(error), type(error.__context__)):
                raise StoppedError from error
            raise

    def format_commands(self, _context: Any, formatter: Any) -> None:
        longest = max(map(len, _MODULES))
        for group, commands in COMMANDS.items():
            with formatter.section(group):
                formatter.write_dl(
                    (name.ljust(longest), does) for name, (_, does) in commands.items()
                )


app = typer.Typer(
    help="Localization that knows when it is not sure: Cluster-MCL over Zenoh.",
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"clustermcl {VERSION}")
        raise typer.Exit


@app.callback()
def _common(
    _version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print only the answer and errors.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", "-v", help="Print more; started processes log at level debug."),
    ] = False,
) -> None:
    """Apply the options before the subcommand."""
    if quiet or verbose:
        set_verbosity(quiet=quiet, verbose=verbose)


def main() -> None:
    """Run the command, and exit with its code; print a `ClusterMclError` as one line."""
    set_verbosity()
    try:
        with written_output():
            app()
    except StoppedError:
        sys.exit(EXIT_INTERRUPTED)
    except (ClusterMclError, NoKernelsError) as error:
        sys.stderr.write(f"clustermcl: {escaped(' '.join(str(error).split()))}\n")
        sys.exit(EXIT_UNREACHABLE if isinstance(error, UnreachableError) else EXIT_ERROR)
    except BrokenPipeError:  # the output's reader, such as `head`, has ended
        sys.stderr.close()
        sys.exit(EXIT_INTERRUPTED)
