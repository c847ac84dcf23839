"""Probes whether a router still accepts clients: Zenoh's router can lock up.

A locked-up router keeps running, but forwards nothing and accepts no connection until it is
restarted (eclipse-zenoh/zenoh issues 1876, 2697 and 2780; observed once in an hour of fault
injection, after the process was frozen for 4 s). Clients cannot distinguish it from an absent one.
"""

import json
import logging
import threading

import zenoh

from zenoh_link.configuration import Configuration, as_zenoh, transport_configuration

_log = logging.getLogger(__name__)

MAX_FAILURES = 3
"""Probes in a row that must fail: one may fail on a busy machine."""
MIN_PROBES = 12
"""Probes before a lock-up may be reported. Otherwise an attacker who blocks the listener with
silent connections could have the router restarted repeatedly, although it serves its clients."""
_ANYWHERE = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}


class RouterProbe:
    """Connects as a client at intervals; failures count only after a first success.

    Args:
        router: the router's configuration.
        patience_s: time-out of one probe [s].
    """

    def __init__(self, router: zenoh.Config, patience_s: float) -> None:
        self._client = client_of(router, patience_s)
        self._looking: threading.Thread | None = None
        self._is_open = self._was_open = False
        self._failed = self._looks = 0

    @property
    def is_locked_up(self) -> bool:
        """Whether the last `MAX_FAILURES` probes failed, after at least `MIN_PROBES`."""
        return self._failed >= MAX_FAILURES and self._looks > MIN_PROBES

    def probe(self) -> threading.Thread:
        """Record the last probe's result and start the next one, unless it still runs.

        Returns:
            The thread of the running probe.
        """
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
            zenoh.open(as_zenoh(self._client)).close()  # type: ignore[no-untyped-call] # the stub's
        except zenoh.ZError as error:
            _log.debug("a client cannot connect: %s", error)
        else:
            self._is_open = self._was_open = True
            _log.debug("clients can connect")


def client_of(router: zenoh.Config, patience_s: float) -> Configuration:
    """Return the configuration of a client on the router's machine, with the router's certificate.

    Args:
        router: the router's configuration.
        patience_s: time-out of connecting [s].
    """
    endpoints = json.loads(router.get_json("listen/endpoints"))
    if isinstance(endpoints, dict):  # by mode
        endpoints = endpoints.get("router")
    endpoint, _, _ = (endpoints or [""])[0].partition("#")
    for anywhere, here in _ANYWHERE.items():
        endpoint = endpoint.replace(f"/{anywhere}:", f"/{here}:")
    transport = transport_configuration()
    transport["link"]["tls"] = _as_client(json.loads(router.get_json("transport/link/tls")))
    return {
        "mode": "client",
        "connect": {
            "endpoints": [endpoint] if endpoint else [],
            "timeout_ms": int(patience_s * 1000),
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": transport,
    }


def _as_client(tls: dict[str, object]) -> dict[str, object]:
    used = {
        "root_ca_certificate": tls.get("root_ca_certificate"),
        "connect_certificate": tls.get("listen_certificate"),
        "connect_private_key": tls.get("listen_private_key"),
        "enable_mtls": tls.get("enable_mtls"),
        "verify_name_on_connect": False,
    }
    return {name: value for name, value in used.items() if value is not None}
