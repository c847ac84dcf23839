"""Whether a router still lets anybody in: it looks as a client would, for Zenoh's may lock up.

A router that locks up lives on, and forwards nothing and lets nobody in until it is started again
(eclipse-zenoh/zenoh issues 1876, 2697 and 2780; seen once in an hour of chaos, after it was frozen
for four seconds). Nothing outside a router tells that from one that is not there.
"""

import json
import logging
import threading

import zenoh

from zenoh_link.configuration import Configuration, as_zenoh, transport_configuration

_log = logging.getLogger(__name__)

MAX_FAILURES = 3
"""Looks in a row that fail: a machine may be very busy."""
MIN_PROBES = 12
"""Before it may be found shut: who fills the door with silent connections shall not be able to
have a router started again and again, for those who are in are served meanwhile."""
_ANYWHERE = {"0.0.0.0": "127.0.0.1", "[::]": "[::1]"}


class RouterProbe:
    """Looks time and again; only what once went well can fail.

    Args:
        router: the router's configuration.
        patience_s: a look that takes longer has failed.
    """

    def __init__(self, router: zenoh.Config, patience_s: float) -> None:
        self._client = client_of(router, patience_s)
        self._looking: threading.Thread | None = None
        self._is_open = self._was_open = False
        self._failed = self._looks = 0

    @property
    def is_locked_up(self) -> bool:
        """Whether the last looks failed, after enough others."""
        return self._failed >= MAX_FAILURES and self._looks > MIN_PROBES

    def probe(self) -> threading.Thread:
        """Note how the last look went and begin the next one, unless it still looks.

        Returns:
            The one that looks now.
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
            _log.debug("no way in: %s", error)
        else:
            self._is_open = self._was_open = True
            _log.debug("clients get in")


def client_of(router: zenoh.Config, patience_s: float) -> Configuration:
    """The configuration of a client of a router on the same machine, with the router's certificate.

    Args:
        router: its configuration.
        patience_s: how long to look for it.
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
