"""The options `--quiet` and `--verbose` of the command, and what they mean for processes."""

import logging
import sys

from clustermcl.protocol.errors import escaped
from clustermcl.runtime.logs import configure_logging, is_quiet

_QUIET, _NORMAL, _VERBOSE = "error", "warning", "info"


def set_verbosity(*, quiet: bool = False, verbose: bool = False) -> None:
    """Write errors to standard error; also warnings unless `quiet`, and more if `verbose`."""
    configure_logging("clustermcl", _QUIET if quiet else _VERBOSE if verbose else _NORMAL)


def is_verbose() -> bool:
    return logging.getLogger().level < logging.WARNING


def say(text: str) -> None:
    """Print a line to standard error, unless `quiet`."""
    if not is_quiet():
        sys.stderr.write(f"clustermcl: {escaped(text)}\n")
        sys.stderr.flush()


def log_settings() -> list[str]:
    """Return the assignment of `log.level` for child processes; empty: as in the settings."""
    if is_quiet():
        return [f"log.level={_QUIET}"]
    return ["log.level=debug"] if is_verbose() else []
