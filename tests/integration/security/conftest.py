"""A router as it is deployed: mutual TLS, access control, a certificate a role."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import zenoh

from clustermcl.link.configuration import as_zenoh
from clustermcl.link.secure_router import secure_router_configuration
from clustermcl.link.session import open_session
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from tests.integration.free_port import free_port
from tests.integration.security.certificates import client_with, make_certificates
from tests.integration.waiting import PATIENCE_S

NAMES = ("robot", "bridge", "worker-a", "worker-b", "coordinator", "viewer", "operator")
"""Every role, with two workers' machines; of the role ``router`` there is one besides."""

OpenAs = Callable[[str], zenoh.Session]


@pytest.fixture(scope="session")
def certificates(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the certificates of all `NAMES` and of the router, made by the script."""
    folder = tmp_path_factory.mktemp("certificates")
    made = make_certificates(folder, "router", *NAMES)
    assert made.returncode == 0, made.stderr
    return folder


@contextmanager
def secure_router(certificates: Path) -> Iterator[str]:
    """A router with the certificates and the access control; where it listens."""
    endpoint = f"tls/localhost:{free_port()}"
    workers = [name for name in NAMES if name.startswith("worker")]
    configuration = secure_router_configuration(endpoint, str(certificates), [], workers)
    with zenoh.open(as_zenoh(configuration)):
        yield endpoint


@pytest.fixture(scope="module")
def secure_endpoint(certificates: Path) -> Iterator[str]:
    with secure_router(certificates) as endpoint:
        yield endpoint


@pytest.fixture(scope="module")
def client_of(certificates: Path, secure_endpoint: str) -> Callable[[str], ZenohSettings]:
    return lambda name: client_with(certificates, name, secure_endpoint)


@pytest.fixture(scope="module")
def as_role(client_of: Callable[[str], ZenohSettings]) -> Iterator[OpenAs]:
    """Sessions by the name of their certificate, opened once, closed after the module."""
    opened: dict[str, zenoh.Session] = {}
    with ExitStack() as sessions:

        def open_as(name: str) -> zenoh.Session:
            if name not in opened:
                session = open_session(
                    client_of(name), RobotSettings(), StopFlag(), wait_s=PATIENCE_S
                )
                opened[name] = sessions.enter_context(session)
            return opened[name]

        yield open_as
