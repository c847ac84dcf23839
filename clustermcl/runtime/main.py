"""The main function of every process: arguments, settings, log, signals, errors, exit code."""

import argparse
import faulthandler
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from clustermcl.filter.kernels.library import NoKernelsError
from clustermcl.protocol.errors import ClusterMclError, escaped
from clustermcl.protocol.keys import LONGEST_NAME, ROOM_FOR_NUMBER, is_name, name_rule
from clustermcl.runtime.logs import configure_logging
from clustermcl.runtime.memory import share_arenas
from clustermcl.runtime.parent import die_with_parent_if_asked, open_standard_files
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.stop import StopFlag, StoppedError, stop_on_signals
from clustermcl.runtime.version import VERSION
from clustermcl.runtime.watchdog import SignsOfLife

EXIT_OK, EXIT_BUG, EXIT_ERROR = 0, 1, 2
"""Success or stopped; a bug, logged with its traceback; an error that the user can fix."""

_EXIT_WITHIN_S = 2.0

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Invocation:
    """Name, settings, arguments and stop flag of a started process."""

    process: str
    """Name in the log and as the sender of messages."""
    settings: Settings
    arguments: argparse.Namespace
    stop: StopFlag
    session: Any = None
    """A Zenoh session shared by the parts of one process; None: each part opens its own."""


class _Parser(argparse.ArgumentParser):
    """Prints an error as one line."""

    def error(self, message: str) -> NoReturn:
        print(f"{self.prog}: {message} (see --help)", file=sys.stderr)  # noqa: T201 - no log yet
        sys.exit(EXIT_ERROR)


def process_main(
    name: str,
    body: Callable[[Invocation], None],
    *,
    describe: str,
    add_arguments: Callable[[argparse.ArgumentParser], None] | None = None,
) -> NoReturn:
    """Run a process and exit, even if something hangs at exit.

    SIGINT and SIGTERM set the stop flag; `body` then returns, or a wait raises `StoppedError`.
    It imports heavy modules and closes its own session.
    """
    open_standard_files()
    die_with_parent_if_asked()
    share_arenas()
    faulthandler.enable()  # prints the stack when systemd's watchdog sends SIGABRT
    stop = stop_on_signals()
    stop.on_look = SignsOfLife().give
    code = run_process(name, body, stop, describe=describe, add_arguments=add_arguments)
    stop.on_look = lambda: None  # a failed process must not report READY now
    if not stop.is_set():  # else the signal handler has set the same timer
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
    """Do as `process_main`, but return the exit code."""
    parser = _Parser(prog=name, description=describe, allow_abbrev=False)
    add = parser.add_argument
    add("--settings", type=Path, metavar="FILE", help="settings file (TOML)")
    override = "override one setting of the file; may be repeated"
    add("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help=override)
    add("--name", type=_name, default=name, help=f"name of this process (default: {name})")
    add("--version", action="version", version=f"clustermcl {VERSION}")
    if add_arguments is not None:
        add_arguments(parser)
    arguments = parser.parse_args(argv)
    configure_logging(arguments.name, "info")

    def load_and_run() -> None:
        settings = load_settings(arguments.settings, arguments.set)
        configure_logging(arguments.name, settings.log.level)
        body(Invocation(arguments.name, settings, arguments, stop))

    return outermost(arguments.name, load_and_run)


def outermost(process: str, action: Callable[[], None]) -> int:
    """Run `action` and return the exit code; this is the only broad `except`.

    A `ClusterMclError` is printed as one line, after the name of the process. Any other exception
    is a bug, and logged with its traceback.
    """
    try:
        action()
    except StoppedError:
        return EXIT_OK
    except (ClusterMclError, NoKernelsError) as error:
        line = escaped(" ".join(str(error).split()))
        print(f"{process}: {line}", file=sys.stderr)  # noqa: T201 - without time stamp
        return EXIT_ERROR
    except Exception:  # noqa: BLE001 - the outermost handler
        _log.exception("a bug ended the process")
        return EXIT_BUG
    return EXIT_OK


def _name(text: str) -> str:
    longest = LONGEST_NAME - ROOM_FOR_NUMBER
    if not is_name(text, longest):
        raise argparse.ArgumentTypeError(f"{text!r} is not a valid name: use {name_rule(longest)}")
    return text
