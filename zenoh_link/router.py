"""The router of one machine: a process with a Zenoh session in router mode.

``python -I -m zenoh_link.router --settings FILE``. Forwarding is native code, so Python costs
only memory. For several machines the official ``zenohd`` with ``deploy/router.json5`` does the
same; only ``zenohd`` has plugins (storage, REST).
"""

import argparse
import logging
import os
from pathlib import Path

import zenoh

from process_runtime.main import EXIT_BUG, Invocation, process_main
from process_runtime.memory import trim_heap
from protocol.errors import AlreadyRunningError, InputFileError, SettingsError
from zenoh_link.configuration import as_zenoh, readable, router_configuration
from zenoh_link.router_probe import RouterProbe
from zenoh_link.threads import MANY_LINKS, receiving_threads

_log = logging.getLogger(__name__)

LOOK_EVERY_S = 5.0
_PATIENCE = 0.8
"""Time-out of a probe, as a fraction of the interval."""
_IN_USE = ("Address already in use", "Unable to acquire lock")


def run_router(invocation: Invocation) -> None:
    """Route until the process is stopped or the router no longer accepts clients.

    Raises:
        InputFileError: the ``--config`` file is missing or not a Zenoh configuration.
    """
    file: Path | None = invocation.arguments.config
    router = invocation.settings.zenoh.router
    if file is None:
        config, endpoints = as_zenoh(router_configuration(invocation.settings.zenoh)), router
    else:
        config = _read(file)
        endpoints = config.get_json("listen/endpoints")
    every_s: float = invocation.arguments.look_every
    probe = RouterProbe(config, _PATIENCE * every_s)
    with listen(config, endpoints):
        _log.info("router listens at %s", endpoints)
        while not invocation.stop.wait(every_s):
            trim_heap()
            probe.probe()
            if probe.is_locked_up:
                _log.error("no client can connect: Zenoh has locked up; exiting for a restart")
                os._exit(EXIT_BUG)  # closing the session would block


def main() -> None:
    process_main(
        "router", run_router, describe="Router of one machine.", add_arguments=_add_arguments
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="Zenoh configuration (JSON5), used unchanged instead of the settings' endpoint",
    )
    parser.add_argument(
        "--look-every",
        type=_seconds,
        default=LOOK_EVERY_S,
        metavar="S",
        help="interval of probing whether clients can connect; the router exits after three "
        f"failures in a row (default: {LOOK_EVERY_S:g} s)",
    )


def _seconds(words: str) -> float:
    seconds = float(words)
    if not 0.1 <= seconds <= 3600.0:
        raise argparse.ArgumentTypeError(f"{words}: between 0.1 and 3600 s")
    return seconds


def listen(config: zenoh.Config, endpoints: str) -> zenoh.Session:
    """Open the router's session.

    Raises:
        AlreadyRunningError: another process listens there.
        SettingsError: an endpoint is malformed, or not an address of this machine.
    """
    try:
        with receiving_threads(MANY_LINKS):
            return zenoh.open(config)
    except zenoh.ZError as error:
        problem = readable(error)
        if any(phrase in problem for phrase in _IN_USE):
            raise AlreadyRunningError(
                what="a router or another program",
                endpoint=endpoints,
                advice="share that router by 'clustermcl up --robot NAME --set "
                "zenoh.start_router=false', stop it, or set zenoh.router",
            ) from error
        raise SettingsError(
            key="zenoh.router", problem=f"cannot listen at {endpoints}: {problem}"
        ) from error


def _read(file: Path) -> zenoh.Config:
    if not file.is_file():
        raise InputFileError(file, "no such file")
    try:
        return zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        raise InputFileError(file, readable(error)) from error


if __name__ == "__main__":
    main()
