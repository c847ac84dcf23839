"""The outermost loop of every process: arguments, settings, log, signals, errors, exit code."""

import argparse
import faulthandler
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import NoReturn

from process_runtime.latency_trace import start_trace
from process_runtime.logs import configure_logging
from process_runtime.memory import share_arenas
from process_runtime.parent import die_with_parent_if_asked
from process_runtime.settings import Settings
from process_runtime.settings_file import load_settings
from process_runtime.stop import StopFlag, StoppedError, stop_on_signals
from process_runtime.watchdog import sign_of_life
from protocol.errors import ClusterMclError
from protocol.names import LONGEST_NAME, ROOM_FOR_NUMBER, is_name, name_rule

EXIT_OK, EXIT_BUG, EXIT_ERROR = 0, 1, 2
"""Ended or asked to stop; a bug, with a traceback; an error that a person can mend."""

_EXIT_WITHIN_S = 2.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Invocation:
    """What a process was started with."""

    process: str
    """Its name, in the log and as the sender of its messages."""
    settings: Settings
    arguments: argparse.Namespace
    stop: StopFlag


class _Parser(argparse.ArgumentParser):
    """Says a mistake in one line."""

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: {message} (see --help)", file=sys.stderr)  # noqa: T201 - before the log
        sys.exit(EXIT_ERROR)


def process_main(
    name: str,
    body: Callable[[Invocation], None],
    *,
    describe: str,
    add_arguments: Callable[[argparse.ArgumentParser], None] | None = None,
) -> NoReturn:
    """Run a process to its end and exit, even if something is left that hangs at the exit.

    `body` imports what is heavy, and opens its session in a context that closes it again.
    SIGINT and SIGTERM set its stop flag; it then returns, or a wait raises `StoppedError`.

    Args:
        name: default of ``--name``.
        body: the process's work.
        describe: one line for ``--help``.
        add_arguments: adds the process's own arguments.
    """
    die_with_parent_if_asked()
    share_arenas()
    faulthandler.enable()  # says where it hangs when systemd ends it by SIGABRT
    stop = stop_on_signals()
    stop.on_look = sign_of_life()
    code = run_process(name, body, stop, describe=describe, add_arguments=add_arguments)
    stop.on_look = lambda: None  # who ended in an error must not say now that it is ready
    if not stop.is_set():  # otherwise the signal has started the same watch
        faulthandler.dump_traceback_later(_EXIT_WITHIN_S, exit=True)
    sys.exit(code)


def run_process(
    name: str,
    body: Callable[[Invocation], None],
    stop: StopFlag,
    *,
    describe: str,
    add_arguments: Callable[[argparse.ArgumentParser], None] | None = None,
    argv: Sequence[str] | None = None,
) -> int:
    """Run a process to its end; as `process_main`, but return the exit code."""
    arguments = _parse(name, describe, add_arguments, argv)
    configure_logging(arguments.name, "info")

    def load_and_run() -> None:
        settings = load_settings(arguments.settings, arguments.set)
        configure_logging(arguments.name, settings.log.level)
        start_trace(settings.log.trace_folder, arguments.name)
        body(Invocation(arguments.name, settings, arguments, stop))

    return outermost(arguments.name, load_and_run)


def outermost(process: str, action: Callable[[], None]) -> int:
    """Run to the end and turn the way it ended into an exit code; the only broad `except`.

    Args:
        process: name in front of an error's one line on standard error.
        action: the work; an error of a person's or peer's making is said in one line,
            anything else is a bug and logged with its traceback.
    """
    try:
        action()
    except StoppedError:
        return EXIT_OK
    except ClusterMclError as error:
        line = " ".join(str(error).split())
        print(f"{process}: {line}", file=sys.stderr)  # noqa: T201 - for people, without time stamp
        return EXIT_ERROR
    except Exception:  # noqa: BLE001 - the one place where everything ends up
        _log.exception("a bug ended the process")
        return EXIT_BUG
    return EXIT_OK


def _parse(
    name: str,
    describe: str,
    add_arguments: Callable[[argparse.ArgumentParser], None] | None,
    argv: Sequence[str] | None,
) -> argparse.Namespace:
    parser = _Parser(prog=name, description=describe, allow_abbrev=False)
    parser.add_argument("--settings", type=Path, metavar="FILE", help="settings file (TOML)")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="one setting, over the file's; may be repeated",
    )
    parser.add_argument(
        "--name", type=_name, default=name, help=f"name of this process (default: {name})"
    )
    parser.add_argument(
        "--version", action="version", version=f"clustermcl {version('clustermcl')}"
    )
    if add_arguments is not None:
        add_arguments(parser)
    return parser.parse_args(argv)


def _name(text: str) -> str:
    longest = LONGEST_NAME - ROOM_FOR_NUMBER
    if not is_name(text, longest):
        raise argparse.ArgumentTypeError(f"{text!r} is no name: use {name_rule(longest)}")
    return text
