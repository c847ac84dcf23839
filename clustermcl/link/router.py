"""The router of one machine: a process with a Zenoh session in router mode.

``python -I -m clustermcl.link.router --settings FILE``. Forwarding is native code, so Python costs
only memory. For several machines the official ``zenohd`` with ``deploy/router.json5`` does the
same; only ``zenohd`` has plugins (storage, REST).
"""

import argparse
import json
import logging
import os
import threading
from pathlib import Path

import zenoh

from clustermcl.link import configuration
from clustermcl.link.session import MANY_LINKS, receiving_threads
from clustermcl.protocol.errors import AlreadyRunningError, InputFileError, SettingsError
from clustermcl.runtime.compressed import os_problem
from clustermcl.runtime.main import EXIT_BUG, Invocation, process_main
from clustermcl.runtime.memory import trim_heap

MAX_FAILURES = 3
"""Probes in a row that must fail: one may fail on a busy machine."""
MIN_PROBES = 12
"""Probes before a lock-up may be reported. Otherwise an attacker who blocks the listener with
silent connections could have the router restarted repeatedly, although it serves its clients."""
LOOK_EVERY_S, _PATIENCE = 5.0, 0.8
"""Interval of probes, and the time-out of one as a fraction of it."""
_IN_USE = ("Address already in use", "Unable to acquire lock")
_ANYWHERE = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}


_log = logging.getLogger(__name__)


class RouterProbe:
    """Connects as a client at intervals; failures count only after a first success.

    Zenoh's router can lock up: it keeps running, but forwards nothing and accepts no connection
    until it is restarted (eclipse-zenoh/zenoh issues 1876, 2697 and 2780; observed once in an hour
    of fault injection, after the process was frozen for 4 s). Clients cannot distinguish it from
    an absent one. A probe fails after `patience_s`.
    """

    def __init__(self, router: zenoh.Config, patience_s: float) -> None:
        self._client = client_of(router, patience_s)
        self._looking: threading.Thread | None = None
        self._is_open = self._was_open = False
        self._failed = self._looks = 0

    @property
    def is_locked_up(self) -> bool:
        """Whether the last `MAX_FAILURES` probes failed, after more than `MIN_PROBES` in all."""
        return self._failed >= MAX_FAILURES and self._looks > MIN_PROBES

    def probe(self) -> threading.Thread:
        """Record the last probe's result; start the next one unless it runs; return its thread."""
        self._looks += 1
        if self._looking is not None:
            self._failed = 0 if self._is_open else self._failed + self._was_open
        if self._looking is None or not self._looking.is_alive():
            self._is_open = False
            self._looking = threading.Thread(target=self._look, name="router probe", daemon=True)
            self._looking.start()
        return self._looking

    def _look(self) -> None:
        try:
            zenoh.open(configuration.as_zenoh(self._client)).close()  # type: ignore[no-untyped-call] # the stub's
        except zenoh.ZError as error:
            _log.debug("a client cannot connect: %s", error)
        else:
            self._is_open = self._was_open = True
            _log.debug("clients can connect")


def client_of(router: zenoh.Config, patience_s: float) -> configuration.Configuration:
    """Return the configuration of a client on the router's machine, with its certificate."""
    endpoints = json.loads(router.get_json("listen/endpoints"))
    if isinstance(endpoints, dict):  # by mode
        endpoints = endpoints.get("router")
    endpoint, _, _ = (endpoints or [""])[0].partition("#")
    for anywhere, here in _ANYWHERE.items():
        endpoint = endpoint.replace(f"/{anywhere}:", f"/{here}:")
    tls = json.loads(router.get_json("transport/link/tls"))
    used = ("root_ca_certificate", "listen_certificate", "listen_private_key", "enable_mtls")
    own = {one.replace("listen", "connect"): tls[one] for one in used if tls.get(one) is not None}
    transport = configuration.transport_configuration()
    transport["link"]["tls"] = {**own, "verify_name_on_connect": False}
    timeout_ms = int(patience_s * 1000)
    return {
        "mode": "client",
        "connect": {"endpoints": [endpoint] if endpoint else [], "timeout_ms": timeout_ms},
        "scouting": configuration.UNSCOUTED,
        "transport": transport,
    }


def run_router(invocation: Invocation) -> None:
    """Route until the process is stopped or the router no longer accepts clients."""
    file: Path | None = invocation.arguments.config
    settings = invocation.settings.zenoh
    if file is None:
        config = configuration.as_zenoh(configuration.router_configuration(settings))
    elif not file.is_file():
        failed = IsADirectoryError() if file.is_dir() else FileNotFoundError()
        raise InputFileError(file, os_problem(failed))
    else:
        try:
            config = zenoh.Config.from_file(str(file))
        except zenoh.ZError as error:
            raise InputFileError(file, configuration.readable(error)) from error
    endpoints = config.get_json("listen/endpoints") if file else settings.router
    probe = RouterProbe(config, _PATIENCE * LOOK_EVERY_S)
    with listen(config, endpoints):
        _log.info("router listens at %s", endpoints)
        while not invocation.stop.wait(LOOK_EVERY_S):
            trim_heap()
            probe.probe()
            if probe.is_locked_up:
                _log.error("no client can connect: Zenoh has locked up; exiting for a restart")
                os._exit(EXIT_BUG)  # closing the session would block


def main() -> None:
    def add_arguments(parser: argparse.ArgumentParser) -> None:
        config = "Zenoh configuration (JSON5), used unchanged"
        parser.add_argument("--config", type=Path, metavar="FILE", help=config)

    about = "Router of one machine."
    process_main("router", run_router, describe=about, add_arguments=add_arguments)


def listen(config: zenoh.Config, endpoints: str) -> zenoh.Session:
    """Open the router's session; refuse an endpoint that is in use, or not of this machine."""
    try:
        with receiving_threads(MANY_LINKS):
            return zenoh.open(config)
    except zenoh.ZError as error:
        problem = configuration.readable(error)
        if any(phrase in problem for phrase in _IN_USE):
            raise AlreadyRunningError(
                what="a router or another program",
                endpoint=endpoints,
                advice="share that router by 'clustermcl up --robot NAME --set "
                "zenoh.start_router=false', stop it, or set zenoh.router",
            ) from error
        problem = f"cannot listen at {endpoints}: {problem}"
        raise SettingsError(key="zenoh.router", problem=problem) from error


if __name__ == "__main__":
    main()
