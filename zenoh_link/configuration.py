"""How every process meets every other: Zenoh's configuration, for clients and for the router.

All processes are clients of one router; only the ROS bridge's session to the robot is a peer, as
ROS nodes are. Endpoints are explicit, and only peers link to each other; shared memory is off (no
gain for messages of some kilobytes, and left behind after a kill -9); a node that says nothing for
2 s is gone; links come back within a second.
"""

import json
import os
import re
from typing import Any

import zenoh

from process_runtime.settings import RobotSettings, ZenohSettings
from protocol.errors import SettingsError
from protocol.sizes import LARGEST_BYTES

CONNECT_TRY_MS = 1000
"""`zenoh.open` looks for the router so long; signals are handled only between two tries."""

_LEASE_MS = 2000
_MAX_MESSAGE_BYTES = 2 * LARGEST_BYTES
"""A larger one is dropped in pieces on its way in, and the link lives on. Zenoh's: a gigabyte."""
_WAIT_BEFORE_CLOSE_US = 300_000
_QUEUED_BATCHES = 16
"""Zenoh's most. With its usual 2, a sender that gets no processor for a millisecond drops scans."""
_UNFINISHED_LINKS = 1000
"""That a router has patience with at a time. Zenoh's 100 are one forgetful client's."""
_HANDSHAKE_TIMEOUT, _HANDSHAKE_TIMEOUT_MS = "tls_handshake_timeout_ms", 600_000
"""After each handshake that fails or times out, Zenoh lets nobody in for 0.1 s. So those who
connect and say nothing may stay: with Zenoh's 10 s, 120 of them keep the door shut."""
GOSSIP = {
    "enabled": True,
    "multihop": False,
    "target": {"router": ["router", "peer"], "peer": ["router"]},
    "autoconnect": {"router": [], "peer": ["router", "peer"]},
    "autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
}
"""As rmw_zenoh has it: the router introduces peers to each other, which then link directly."""
SOCKET_PATH_MAX_BYTES = 107
"""Of a Unix socket, on Linux."""
_HOST_AND_PORT = re.compile(r"(\[[0-9A-Fa-f:.%\w]+\]|[^\s:/?#\[\]]+):(\d{1,5})([?#].*)?")

Configuration = dict[str, Any]


def client_configuration(settings: ZenohSettings, robot: RobotSettings | None) -> Configuration:
    """Zenoh's configuration of a process that serves one robot; None: keys are as they are.

    Raises:
        SettingsError: the endpoint is malformed, or a certificate's file cannot be used.
    """
    check_endpoint(settings.router)
    transport = transport_configuration()
    if settings.router.startswith("tls/"):
        transport["link"]["tls"] = {"verify_name_on_connect": True, **_tls(settings, "connect")}
    return {
        "mode": "client",
        **({"namespace": robot.name} if robot is not None else {}),
        "connect": {
            "endpoints": [settings.router],
            "timeout_ms": CONNECT_TRY_MS,
            "retry": {
                "period_init_ms": 200,
                "period_max_ms": 1000,
                "period_increase_factor": 2,
            },
        },
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "queries_default_timeout": int(settings.query_timeout_s * 1000),
        "timestamping": {"enabled": True},
        "transport": transport,
    }


def peer_configuration(settings: ZenohSettings) -> Configuration:
    """Zenoh's configuration of a ROS node on the router's own machine, by rmw_zenoh's settings.

    Peers keep their direct links when the router ends.

    Raises:
        SettingsError: as `client_configuration`.
    """
    configuration = client_configuration(settings, None)
    configuration["connect"]["exit_on_failure"] = True  # `zenoh.open` returns with a link, or not
    return configuration | {
        "mode": "peer",
        "listen": {"endpoints": ["tcp/localhost:0"]},
        "scouting": {"multicast": {"enabled": False}, "gossip": GOSSIP},
    }


def router_configuration(settings: ZenohSettings) -> Configuration:
    """Zenoh's configuration of the router; the official ``zenohd`` takes the same.

    Raises:
        SettingsError: the endpoint is malformed, or a certificate's file cannot be used.
    """
    check_endpoint(settings.router)
    transport = transport_configuration()
    if settings.router.startswith("tls/"):
        if not settings.tls_certificate:
            raise SettingsError(
                key="zenoh.tls_certificate",
                problem=f"zenoh.router = {settings.router!r}: a router there needs a certificate: "
                f"set zenoh.tls_certificate and zenoh.tls_private_key",
            )
        mutual = bool(settings.tls_ca_certificate)
        transport["link"]["tls"] = {"enable_mtls": mutual, **_tls(settings, "listen")}
    transport["unicast"] = {"accept_pending": _UNFINISHED_LINKS}
    # Direct links of peers would bypass the access control of a router with TLS.
    gossip = {"enabled": False} if settings.router.startswith("tls/") else GOSSIP
    return {
        "mode": "router",
        "listen": {"endpoints": [patient(settings.router)]},
        # Without a delay: there is nobody to scout for, and opening takes 2 ms, not 500.
        "scouting": {
            "delay": 0,
            "multicast": {"enabled": False},
            "gossip": gossip,
        },
        "timestamping": {"enabled": True},
        "transport": transport,
    }


def patient(endpoint: str) -> str:
    """The endpoint of a listener that waits long for those who connect by TLS and say nothing."""
    if not endpoint.startswith("tls/") or _HANDSHAKE_TIMEOUT in endpoint:
        return endpoint
    separator = ";" if "#" in endpoint else "#"
    return f"{endpoint}{separator}{_HANDSHAKE_TIMEOUT}={_HANDSHAKE_TIMEOUT_MS}"


def as_json5(configuration: Configuration) -> str:
    """Write a configuration as a file for ``zenohd --config``; JSON is JSON5."""
    return json.dumps(configuration, indent=2) + "\n"


def as_zenoh(configuration: Configuration) -> zenoh.Config:
    """Hand a configuration to the Zenoh library.

    Raises:
        SettingsError: Zenoh refuses it, for example a robot's name with a star in it.
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
    """The part of Zenoh's message that is for people: no places in its source, one line."""
    text = " ".join(str(error).split())
    inner = re.search(r'(?:message|msg): "(.*?)"', text)
    return re.sub(r"\s*at \S+\.rs:\d+\.?", "", inner[1] if inner else text).strip()


def check_endpoint(endpoint: str) -> None:
    """Refuse an endpoint that no process could ever listen on or connect to.

    Zenoh itself goes on trying to connect to a misspelt one until the time is up.

    Raises:
        SettingsError: it is not ``tcp/HOST:PORT``, ``tls/HOST:PORT`` or
            ``unixsock-stream//PATH``, or the path is too long for a socket.
    """
    protocol, _, address = endpoint.partition("/")
    problem = None
    if protocol in ("tcp", "tls"):
        parts = _HOST_AND_PORT.fullmatch(address)
        if parts is None or not 0 < int(parts[2]) < 65536:
            problem = f"write {protocol}/HOST:PORT"
    elif protocol == "unixsock-stream":
        if not address.startswith("/"):
            problem = "write unixsock-stream/ and an absolute path, so two slashes"
        elif len(os.fsencode(address)) > SOCKET_PATH_MAX_BYTES:
            problem = f"a socket's path has at most {SOCKET_PATH_MAX_BYTES} bytes"
    else:
        problem = "write tcp/HOST:PORT, tls/HOST:PORT or unixsock-stream//PATH"
    if problem:
        raise SettingsError(
            key="zenoh.router", problem=f"zenoh.router = {endpoint!r} is not an endpoint: {problem}"
        )


def transport_configuration() -> Configuration:
    """What links of clients and of the router have in common."""
    return {
        "shared_memory": {"enabled": False},
        "link": {
            "rx": {"max_message_size": _MAX_MESSAGE_BYTES},
            "tx": {
                "lease": _LEASE_MS,
                "keep_alive": 4,
                "queue": {
                    "size": {"data_high": _QUEUED_BATCHES},
                    # A frozen process may hold the others up 0.3 s, not Zenoh's 5 s.
                    "congestion_control": {"block": {"wait_before_close": _WAIT_BEFORE_CLOSE_US}},
                },
            },
        },
    }


def _tls(settings: ZenohSettings, direction: str) -> Configuration:
    """The certificate files that are given; a client with one of its own shows it."""
    own = bool(settings.tls_certificate)
    files = {
        "root_ca_certificate": settings.tls_ca_certificate,
        f"{direction}_certificate": settings.tls_certificate,
        f"{direction}_private_key": settings.tls_private_key,
    }
    from zenoh_link.tls import check_files  # noqa: PLC0415 - 10 ms for those who need it

    check_files(settings)  # Zenoh would only say that it cannot connect
    mutual = {"enable_mtls": True} if direction == "connect" and own else {}
    return {name: path for name, path in files.items() if path} | mutual
