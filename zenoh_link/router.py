"""The router of one machine: a Zenoh session in router mode, in a process of its own.

``python -I -m zenoh_link.router --settings FILE``. Forwarding is native code, so Python costs
nothing but memory. Where several machines meet, the official ``zenohd`` does the same job with
``deploy/router.json5``; plugins (storage, REST) exist only there.
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
"""Of the time between two looks."""
_IN_USE = ("Address already in use", "Unable to acquire lock")


def run_router(invocation: Invocation) -> None:
    """Route until the process is told to stop, or nobody gets in any more.

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
                _log.error("nobody gets in any more: Zenoh has locked up; ending, to be restarted")
                os._exit(EXIT_BUG)  # to close the session would wait for ever


def main() -> None:
    """Run the router process."""
    process_main(
        "router", run_router, describe="Router of one machine.", add_arguments=_add_arguments
    )


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config",
        type=Path,
        metavar="FILE",
        help="Zenoh configuration (JSON5) used as it is, instead of the settings' endpoint",
    )
    parser.add_argument(
        "--look-every",
        type=_seconds,
        default=LOOK_EVERY_S,
        metavar="S",
        help="look so often whether clients still get in; the router ends after three failed looks "
        f"(default: {LOOK_EVERY_S:g})",
    )


def _seconds(words: str) -> float:
    seconds = float(words)
    if not 0.1 <= seconds <= 3600.0:
        raise argparse.ArgumentTypeError(f"{words}: between 0.1 and 3600 s")
    return seconds


def listen(config: zenoh.Config, endpoints: str) -> zenoh.Session:
    """Listen at the endpoints of a configuration and forward between all who connect.

    Raises:
        AlreadyRunningError: something listens there already.
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
