"""Zenoh's configuration for clients, for the ROS bridge's peer session and for the router.

All processes are clients of one router; only the ROS bridge's session to the robot is a peer, like
ROS nodes. Endpoints are explicit. Shared memory is off: it gains nothing for messages of a few
kilobytes, and its segments remain after a kill -9. A link expires after 2 s of silence and
reconnects within a second.
"""

import json
import os
import re
from typing import Any

import zenoh

from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.message import LARGEST_BYTES
from clustermcl.runtime.settings import SOCKET_PATH_MAX_BYTES, RobotSettings, ZenohSettings

CONNECT_TRY_MS = 1000
"""Time-out of one `zenoh.open`; Python handles signals only between two attempts."""

_LEASE_MS = 2000
_MAX_MESSAGE_BYTES = 2 * LARGEST_BYTES
"""A larger message is dropped while its fragments arrive; the link stays up. Zenoh: 1 GB."""
_WAIT_BEFORE_CLOSE_US = 300_000
_QUEUED_BATCHES = 16
"""Zenoh's maximum. With its default 2, a sender that is off the CPU for 1 ms drops scans."""
_UNFINISHED_LINKS = 1000
"""Pending connections a router accepts. One faulty client uses up Zenoh's default of 100."""
_HANDSHAKE_TIMEOUT, _HANDSHAKE_TIMEOUT_MS = "tls_handshake_timeout_ms", 600_000
"""Zenoh accepts no connection for 0.1 s after a failed or timed-out handshake. With its default
time-out of 10 s, 120 silent connections would block the listener."""
_HOST_AND_PORT = re.compile(r"(\[[0-9A-Fa-f:.%\w]+\]|[^\s:/?#\[\]]+):(\d{1,5})([?#].*)?")

Configuration = dict[str, Any]
UNSCOUTED: Configuration = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
"""Endpoints are explicit; links of peers, found by gossip, would bypass access control."""


def client_configuration(settings: ZenohSettings, robot: RobotSettings) -> Configuration:
    """Return the configuration of a client; a robot's name becomes the namespace of all keys.

    Raises:
        SettingsError: the endpoint is malformed, or a certificate's file cannot be used.
    """
    check_endpoint(settings.router)
    transport = transport_configuration()
    if settings.router.startswith("tls/"):
        transport["link"]["tls"] = {"verify_name_on_connect": True, **_tls(settings, "connect")}
    return {
        "mode": "client",
        "namespace": robot.name,
        "connect": {
            "endpoints": [settings.router],
            "timeout_ms": CONNECT_TRY_MS,
            "retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "scouting": UNSCOUTED,
        "queries_default_timeout": int(settings.query_timeout_s * 1000),
        "timestamping": {"enabled": True},
        "transport": transport,
    }


def router_configuration(settings: ZenohSettings) -> Configuration:
    """Return the configuration of the router; the official ``zenohd`` accepts it too."""
    check_endpoint(settings.router)
    transport = transport_configuration()
    if settings.router.startswith("tls/"):
        if not settings.tls_certificate:
            problem = f"zenoh.router = {settings.router!r}: a router there needs a certificate: "
            problem += "set zenoh.tls_certificate and zenoh.tls_private_key"
            raise SettingsError(key="zenoh.tls_certificate", problem=problem)
        mutual = bool(settings.tls_ca_certificate)
        transport["link"]["tls"] = {"enable_mtls": mutual, **_tls(settings, "listen")}
    transport["unicast"] = {"accept_pending": _UNFINISHED_LINKS}
    return {
        "mode": "router",
        "listen": {"endpoints": [patient(settings.router)]},
        "scouting": {"delay": 0, **UNSCOUTED},  # opening takes 2 ms instead of 500
        "timestamping": {"enabled": True},
        "transport": transport,
    }


def patient(endpoint: str) -> str:
    """Return the endpoint of a listener with a long TLS handshake time-out."""
    if not endpoint.startswith("tls/") or _HANDSHAKE_TIMEOUT in endpoint:
        return endpoint
    separator = ";" if "#" in endpoint else "#"
    return f"{endpoint}{separator}{_HANDSHAKE_TIMEOUT}={_HANDSHAKE_TIMEOUT_MS}"


def as_zenoh(configuration: Configuration) -> zenoh.Config:
    """Convert a configuration to the Zenoh library's type.

    Raises:
        SettingsError: Zenoh rejects it, for example a robot's name with a star in it.
    """
    config = zenoh.Config()
    for key, value in configuration.items():
        try:
            config.insert_json5(key, json.dumps(value))
        except zenoh.ZError as error:
            what = "robot.name" if key == "namespace" else f"Zenoh's {key}"
            problem = f"{what} = {json.dumps(value)}: {readable(error)}"
            raise SettingsError(key=what, problem=problem) from error
    return config


def readable(error: zenoh.ZError) -> str:
    """Return Zenoh's message as one line, without its source locations."""
    text = " ".join(str(error).split())
    inner = re.search(r'(?:message|msg): "(.*?)"', text)
    return re.sub(r"\s*at \S+\.rs:\d+\.?", "", inner[1] if inner else text).strip()


def check_endpoint(endpoint: str) -> None:
    """Raise `SettingsError` for a bad endpoint, to which Zenoh would connect until its time-out."""
    protocol, _, address = endpoint.partition("/")
    if protocol in ("tcp", "tls"):
        parts = _HOST_AND_PORT.fullmatch(address)
        if parts and 0 < int(parts[2]) < 65536:
            return
        problem = f"write {protocol}/HOST:PORT"
    elif protocol != "unixsock-stream":
        problem = "write tcp/HOST:PORT, tls/HOST:PORT or unixsock-stream//PATH"
    elif not address.startswith("/"):
        problem = "write unixsock-stream/ and an absolute path, so two slashes"
    elif len(os.fsencode(address)) > SOCKET_PATH_MAX_BYTES:
        problem = f"a socket's path has at most {SOCKET_PATH_MAX_BYTES} bytes"
    else:
        return
    raise SettingsError(f"zenoh.router = {endpoint!r} is not an endpoint: {problem}")


def transport_configuration() -> Configuration:
    """Return the transport settings that clients and the router share."""
    return {
        "shared_memory": {"enabled": False},
        "link": {
            "rx": {"max_message_size": _MAX_MESSAGE_BYTES},
            "tx": {
                "lease": _LEASE_MS,
                "keep_alive": 4,
                "queue": {
                    "size": {"data_high": _QUEUED_BATCHES},
                    # A frozen process may block the others for 0.3 s, not for Zenoh's default 5 s.
                    "congestion_control": {"block": {"wait_before_close": _WAIT_BEFORE_CLOSE_US}},
                },
            },
        },
    }


def _tls(settings: ZenohSettings, direction: str) -> Configuration:
    """Return the TLS section; a client that has a certificate uses mutual TLS."""
    from clustermcl.link.tls import check_files  # noqa: PLC0415 - import takes 10 ms

    check_files(settings)  # Zenoh would only report that it cannot connect
    files = {
        "root_ca_certificate": settings.tls_ca_certificate,
        f"{direction}_certificate": settings.tls_certificate,
        f"{direction}_private_key": settings.tls_private_key,
    }
    is_mutual = direction == "connect" and settings.tls_certificate
    mutual = {"enable_mtls": True} if is_mutual else {}
    return {name: path for name, path in files.items() if path} | mutual
