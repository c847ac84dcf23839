import shutil
from collections.abc import Callable
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import msgspec
import pytest

from clustermcl.link.node import Node
from clustermcl.link.session import open_session
from clustermcl.protocol.errors import UnreachableError
from clustermcl.runtime.settings import RobotSettings, Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from tests.integration.security.certificates import (
    client_with,
    make_certificates,
    require_openssl,
    with_lifetime,
    without_certificate,
)
from tests.integration.waiting import wait_until

require_openssl()

ClientOf = Callable[[str], ZenohSettings]


def refusal(settings: ZenohSettings) -> str:
    with (
        pytest.raises(UnreachableError) as caught,
        open_session(settings, RobotSettings(), StopFlag(), wait_s=1.0),
    ):
        pass
    return str(caught.value)


@pytest.fixture
def scratch(certificates: Path, tmp_path: Path) -> Path:
    return shutil.copytree(certificates, tmp_path / "certificates")


def test_without_a_certificate_a_connection_is_refused(client_of: ClientOf) -> None:
    output = refusal(without_certificate(client_of("viewer")))
    assert "a client without a certificate: the router requires a certificate" in output


def test_certificates_of_unknown_authorities_are_refused_by_router_and_client(
    client_of: ClientOf, tmp_path: Path
) -> None:
    make_certificates(tmp_path, "viewer")
    ours = client_of("viewer")
    theirs = client_with(tmp_path, "viewer", ours.router)
    assert "the router's certificate is not trusted" in refusal(theirs)
    theirs = msgspec.structs.replace(theirs, tls_ca_certificate=ours.tls_ca_certificate)
    assert "it is not signed by the router's authority" in refusal(theirs)


@pytest.mark.parametrize(("begin_days", "end_days"), [(-9, -1), (1, 9)])
def test_a_certificate_of_another_time_is_refused(
    client_of: ClientOf, scratch: Path, begin_days: int, end_days: int
) -> None:
    with_lifetime(scratch, "viewer", timedelta(days=begin_days), timedelta(days=end_days))
    settings = client_with(scratch, "viewer", client_of("viewer").router)
    output = refusal(settings)
    assert "it has expired, or is not valid yet" in output
    assert settings.tls_certificate in output


def test_the_routers_certificate_makes_no_client_and_other_errors_blame_no_certificate(
    client_of: ClientOf,
) -> None:
    viewer = client_of("viewer")
    assert "it is not a client's certificate" in refusal(client_of("router"))
    plain = viewer.router.replace("tls/", "tcp/")
    assert "the router there has TLS" in refusal(ZenohSettings(router=plain))
    assert "no router at tcp/" in refusal(ZenohSettings(router="tcp/localhost:1"))
    away = msgspec.structs.replace(viewer, router="tls/localhost:1")
    assert refusal(away).startswith("no router at tls/localhost:1 within")


def test_a_link_ends_with_its_certificate_which_is_reported_and_returns_with_a_new_one(
    client_of: ClientOf, scratch: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with_lifetime(scratch, "viewer", -timedelta(days=1), timedelta(seconds=8))
    zenoh = client_with(scratch, "viewer", client_of("viewer").router)
    settings = msgspec.structs.replace(Settings(), zenoh=zenoh)
    with closing(Node("c", "coordinator", settings, StopFlag(), peers=None)) as node:
        session = node.open(wait_s=8.0)
        assert "viewer.pem: its role is viewer" in caplog.text
        wait_until(lambda: node.turn(0.1) is None and "it has expired" in caplog.text)
        assert not session.info.routers_zid()
        made = make_certificates(scratch, "--force", "viewer")
        assert made.returncode == 0, made.stderr
        wait_until(session.info.routers_zid)
