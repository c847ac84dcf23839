import select
import socket
import ssl
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from clustermcl.link.session import open_session
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from tests.integration.security.certificates import client_with, require_openssl
from tests.integration.security.conftest import secure_router
from tests.integration.waiting import stretched_s, wait_until

require_openssl()

SILENT = 150
"""More than the 100 that Zenoh has patience with."""
ZENOHS_PATIENCE_S = 10.0


@pytest.fixture
def endpoint(certificates: Path) -> Iterator[str]:
    """A router of a test's own: when silent connections end, it is slow for some seconds."""
    with secure_router(certificates) as endpoint:
        yield endpoint


@pytest.fixture
def silent(endpoint: str) -> Iterator[list[socket.socket]]:
    host, _, port = endpoint.removeprefix("tls/").rpartition(":")
    with ExitStack() as held:
        address = (host, int(port))
        yield [held.enter_context(socket.create_connection(address)) for _ in range(SILENT)]


def gets_in_at_once(viewer: ZenohSettings) -> None:
    with open_session(
        viewer, RobotSettings(), StopFlag(), wait_s=min(stretched_s(2.0), 0.9 * ZENOHS_PATIENCE_S)
    ) as session:
        wait_until(session.info.routers_zid)


def test_silent_connections_do_not_lock_out_others(
    certificates: Path, endpoint: str, silent: list[socket.socket]
) -> None:
    viewer = client_with(certificates, "viewer", endpoint)
    gets_in_at_once(viewer)
    # Whenever the router drops one of them, it accepts no connection for a moment.
    select.select(silent, [], [], 1.2 * ZENOHS_PATIENCE_S)
    gets_in_at_once(viewer)


def test_authenticated_silent_connections_do_not_lock_out_others(
    certificates: Path, endpoint: str, silent: list[socket.socket]
) -> None:
    operator = client_with(certificates, "operator", endpoint)
    shown = ssl.create_default_context(cafile=operator.tls_ca_certificate)
    shown.load_cert_chain(operator.tls_certificate, operator.tls_private_key)
    with ExitStack() as held:
        for connection in silent:
            held.enter_context(shown.wrap_socket(connection, server_hostname="localhost"))
        gets_in_at_once(client_with(certificates, "viewer", endpoint))
