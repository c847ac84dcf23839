from collections.abc import Callable
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
    ("wrong", "expected"),
    [
        (
            lambda folder: {"tls_ca_certificate": f"{folder}/none.pem"},
            r"zenoh\.tls_ca_certificate = '.*/none\.pem': no such file",
        ),
        (
            lambda folder: {"tls_certificate": f"{folder}"},
            r"zenoh\.tls_certificate = '.*': is a folder",
        ),
        (
            lambda folder: {"tls_certificate": f"{folder}/viewer.key"},
            r"zenoh\.tls_certificate = '.*/viewer\.key': there is no certificate in it",
        ),
        (
            lambda folder: {"tls_private_key": f"{folder}/viewer.pem"},
            r"zenoh\.tls_private_key = '.*/viewer\.pem': there is no private key in it",
        ),
        (
            lambda folder: {"tls_private_key": f"{folder}/operator.key"},
            r"operator\.key' and .*viewer\.pem' do not match: the key belongs to another",
        ),
        (
            lambda _: {"tls_private_key": ""},
            r"zenoh\.tls_private_key is not set, but zenoh\.tls_certificate is",
        ),
        (
            lambda _: {"tls_certificate": ""},
            r"zenoh\.tls_certificate is not set, but zenoh\.tls_private_key is",
        ),
    ],
)
def test_a_file_that_cannot_be_used_is_named_with_its_setting(
    viewer: ZenohSettings,
    certificates: Path,
    wrong: Callable[[Path], dict[str, str]],
    expected: str,
) -> None:
    settings = msgspec.structs.replace(viewer, **wrong(certificates))
    with pytest.raises(SettingsError, match=expected):
        client_configuration(settings, RobotSettings())


def test_a_truncated_authority_file_is_refused(viewer: ZenohSettings, tmp_path: Path) -> None:
    broken = tmp_path / "authority.pem"
    broken.write_text("-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n")
    settings = msgspec.structs.replace(viewer, tls_ca_certificate=str(broken))
    with pytest.raises(SettingsError, match=r"tls_ca_certificate = .* not a certificate"):
        client_configuration(settings, RobotSettings())


def test_a_router_at_a_tls_endpoint_needs_a_certificate(viewer: ZenohSettings) -> None:
    with pytest.raises(SettingsError, match="a router there needs a certificate"):
        router_configuration(without_certificate(viewer))
