"""The command `clustermcl`: the table of its subcommands, and the exit codes."""

import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from clustermcl.commands import control, query, recordings, running
from clustermcl.commands.verbosity import set_verbosity
from clustermcl.filter.kernels.library import NoKernelsError
from clustermcl.protocol.errors import ClusterMclError, UnreachableError, escaped
from clustermcl.runtime.main import EXIT_ERROR
from clustermcl.runtime.output_files import written_output
from clustermcl.runtime.stop import StoppedError
from clustermcl.runtime.version import VERSION

EXIT_UNREACHABLE, EXIT_INTERRUPTED = 3, 130
"""Exit codes: no router or process answers; Ctrl-C, or the output's reader has ended."""


class _Commands(TyperGroup):
    """The command's group, whose help has a section for each group of commands."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        early = _BEFORE_THE_COMMAND.intersection(
            args[1 : args.index("--") if "--" in args else None]
        )
        for option in early:
            line = f"clustermcl {option} {args[0]}"
            ctx.fail(f"{option} stands before the command: {line} ...")
        return super().resolve_command(ctx, args)

    def format_commands(self, _context: Any, formatter: Any) -> None:
        longest = max(map(len, self.commands))
        for group, names in COMMANDS.items():
            with formatter.section(group):
                formatter.write_dl(
                    (name.ljust(longest), self.commands[name].get_short_help_str(formatter.width))
                    for name in names
                )


app = typer.Typer(
    help="Localization that knows when it is not sure: Cluster-MCL over Zenoh.",
    cls=_Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
_BEFORE_THE_COMMAND = {"--quiet", "-q", "--verbose", "-v", "--version"}
_NUMBERS_MAY_BE_NEGATIVE = {"ignore_unknown_options": True}
COMMANDS: dict[str, dict[str, Callable[..., None]]] = {
    "Start here": {
        "demo": running.demo,
        "up": running.up,
        "view": running.serve_view,
    },
    "Query a running system": {
        "pose": query.pose,
        "hypotheses": query.hypotheses,
        "advise": query.advise,
        "watch": query.watch,
        "events": query.events,
        "status": query.status,
        "snapshot": query.snapshot,
        "changes": recordings.changes,
        "record": recordings.record,
        "record-landmarks": recordings.record_landmarks,
    },
    "Control a running system": {
        "set-pose": control.set_pose,
        "relocalize": control.relocalize,
        "update": control.update,
        "kidnap": control.kidnap,
    },
    "Maps, recordings, settings": {
        "check": recordings.check,
        "evaluate": recordings.evaluate,
        "replay": recordings.replay,
        "settings": recordings.settings,
    },
    "Single processes": {
        "warm-up": running.warm_up,
        "router": running.router,
        "worker": running.worker,
    },
}
for _group, _commands in COMMANDS.items():
    for _name, _command in _commands.items():
        app.command(
            _name,
            rich_help_panel=_group,
            context_settings=_NUMBERS_MAY_BE_NEGATIVE if _name == "set-pose" else None,
        )(_command)


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
