"""The options `--quiet` and `--verbose`, before or after the name of any command."""

import logging
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from process_runtime.logs import configure_logging, is_quiet

_QUIET, _NORMAL, _VERBOSE = "error", "warning", "info"


def set_verbosity(level: str = _NORMAL) -> None:
    """Write log messages of this level and above to standard error."""
    configure_logging("clustermcl", level)


def is_verbose() -> bool:
    return logging.getLogger().level < logging.WARNING


def log_settings() -> list[str]:
    """Return the assignment of `log.level` for child processes; empty: as in the settings."""
    if is_quiet():
        return [f"log.level={_QUIET}"]
    return ["log.level=debug"] if is_verbose() else []


def _quiet(asked: bool) -> None:
    if asked:
        set_verbosity(_QUIET)


def _verbose(asked: bool) -> None:
    if asked:
        set_verbosity(_VERBOSE)


def _options(
    _be_quiet: Annotated[
        bool,
        typer.Option(
            "--quiet",
            "-q",
            callback=_quiet,
            expose_value=False,
            help="Print only the answer and errors.",
        ),
    ] = False,
    _be_verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            "-v",
            callback=_verbose,
            expose_value=False,
            help="Print more; started processes log at level debug.",
        ),
    ] = False,
) -> None: ...


class VerbosityGroup(TyperGroup):
    """A command group that takes `--quiet` and `--verbose`, and adds them to its commands."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        both = typer.Typer(add_completion=False)
        both.command()(_options)
        for command in (self, *self.commands.values()):
            command.params += get_command(both).params
