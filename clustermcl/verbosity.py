"""`--quiet` and `--verbose`, before or after the name of any command."""

import logging
from typing import Annotated, Any

import typer
from typer.core import TyperGroup
from typer.main import get_command

from process_runtime.logs import configure_logging, is_quiet

_QUIET, _NORMAL, _VERBOSE = "error", "warning", "info"


def set_verbosity(level: str = _NORMAL) -> None:
    """Say on standard error what is at least this severe."""
    configure_logging("clustermcl", level)


def is_verbose() -> bool:
    """Whether a person wants to hear more than usual."""
    return logging.getLogger().level < logging.WARNING


def log_settings() -> list[str]:
    """The level for processes that a command starts, as settings that others may override."""
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
            help="Say nothing but the answer, and errors.",
        ),
    ] = False,
    _be_verbose: Annotated[
        bool,
        typer.Option(
            "--verbose",
            "-v",
            callback=_verbose,
            expose_value=False,
            help="Say more; processes that are started log all they do.",
        ),
    ] = False,
) -> None:
    """Both options, for those who take them from here."""


class VerbosityGroup(TyperGroup):
    """A group that takes both options itself, and has each of its commands take them."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        both = typer.Typer(add_completion=False)
        both.command()(_options)
        for command in (self, *self.commands.values()):
            command.params += get_command(both).params
