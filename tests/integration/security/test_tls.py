from pathlib import Path

import msgspec
import pytest

from clustermcl.link.configuration import client_configuration, router_configuration
from clustermcl.link.session import open_session
from clustermcl.protocol.errors import SettingsError, UnreachableError
from clustermcl.runtime.settings import RobotSettings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from tests.integration.free_port import free_port
from tests.integration.routers import open_router
from tests.integration.security.certificates import (
    client_with,
    require_openssl,
    without_certificate,
)
from tests.integration.waiting import PATIENCE_S, wait_until

require_openssl()


@pytest.fixture
def viewer(certificates: Path) -> ZenohSettings:
    """Settings of a client of a router that does not run."""
    return client_with(certificates, "viewer", f"tls/localhost:{free_port()}")


def test_a_router_with_certificates_in_its_settings_requires_client_certificates(
    viewer: ZenohSettings, certificates: Path
) -> None:
    with open_router(client_with(certificates, "router", viewer.router)):
        with open_session(viewer, RobotSettings(), StopFlag(), wait_s=PATIENCE_S) as session:
            wait_until(session.info.routers_zid)
        with (
            pytest.raises(UnreachableError, match="requires a certificate"),
            open_session(without_certificate(viewer), RobotSettings(), StopFlag(), wait_s=1.0),
        ):
            pass


def test_a_router_at_a_host_that_its_certificate_does_not_name_is_refused(
    certificates: Path,
) -> None:
    endpoint = f"tls/127.0.0.2:{free_port()}"
    with open_router(client_with(certificates, "router", endpoint)):
        client = client_with(certificates, "viewer", endpoint)
        with (
            pytest.raises(UnreachableError),
            open_session(client, RobotSettings(), StopFlag(), 1.0),
        ):
            pass


@pytest.mark.parametrize(
    ("name", "file", "problem"),
    [
        ("tls_ca_certificate", "none.pem", "no such file"),
        ("tls_ca_certificate", "truncated.pem", "not a certificate"),
        ("tls_certificate", "viewer.key", "there is no certificate in it"),
        ("tls_private_key", "viewer.pem", "there is no private key in it"),
        ("tls_private_key", "operator.key", "do not match: the key belongs to another"),
        ("tls_private_key", "", "is not set, but zenoh.tls_certificate is"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_its_setting(
    viewer: ZenohSettings, certificates: Path, name: str, file: str, problem: str
) -> None:
    truncated = "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n"
    (certificates / "truncated.pem").write_text(truncated)
    path = str(certificates / file) if file else ""
    settings = msgspec.structs.replace(viewer, **{name: path})
    with pytest.raises(SettingsError, match=rf"zenoh\.{name} .*{problem}") as caught:
        client_configuration(settings, RobotSettings())
    assert path in str(caught.value)
    with pytest.raises(SettingsError, match="a router there needs a certificate"):
        router_configuration(without_certificate(viewer))
