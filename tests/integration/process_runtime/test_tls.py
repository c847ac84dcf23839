"""Mutual TLS with real certificates: who has none, or one of a stranger's, stays outside."""

import shutil
import socket
import subprocess
from pathlib import Path

import msgspec
import pytest

from process_runtime.router import open_router
from process_runtime.session import open_session
from process_runtime.settings import RobotSettings, ZenohSettings
from process_runtime.stop import StopFlag
from protocol.errors import UnreachableError
from tests.integration.waiting import wait_until

if shutil.which("openssl") is None:
    pytest.skip("openssl makes the certificates and is not installed", allow_module_level=True)


def free_port() -> int:
    """A port that was free a moment ago."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


def openssl(*arguments: str | Path) -> None:
    subprocess.run(["openssl", *map(str, arguments)], check=True, capture_output=True)


def make_authority(folder: Path, name: str) -> Path:
    """A certificate authority; the key lies beside the certificate that is returned."""
    certificate = folder / f"{name}.pem"
    openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
        *("-days", "1", "-subj", f"/CN={name}", "-keyout", folder / f"{name}.key"),
        *("-out", certificate),
    )
    return certificate


def issue(authority: Path, name: str, usage: str) -> ZenohSettings:
    """Settings with a certificate signed by the authority, for ``serverAuth`` or ``clientAuth``."""
    folder = authority.parent
    request, extensions = folder / f"{name}.csr", folder / f"{name}.ext"
    certificate, key = folder / f"{name}.pem", folder / f"{name}.key"
    extensions.write_text(
        f"extendedKeyUsage = {usage}\nsubjectAltName = DNS:localhost,IP:127.0.0.1\n"
    )
    openssl(
        *("req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
        *("-subj", f"/CN={name}", "-keyout", key, "-out", request),
    )
    openssl(
        *(
            "x509",
            "-req",
            "-in",
            request,
            "-CA",
            authority,
            "-CAkey",
            authority.with_suffix(".key"),
        ),
        *("-CAcreateserial", "-days", "1", "-extfile", extensions, "-out", certificate),
    )
    return ZenohSettings(
        tls_ca_certificate=str(authority),
        tls_certificate=str(certificate),
        tls_private_key=str(key),
    )


def test_only_who_has_a_certificate_of_the_routers_authority_gets_in(tmp_path: Path) -> None:
    ours, strangers = make_authority(tmp_path, "ours"), make_authority(tmp_path, "strangers")
    endpoint = f"tls/localhost:{free_port()}"

    def at_endpoint(settings: ZenohSettings) -> ZenohSettings:
        return msgspec.structs.replace(settings, router=endpoint)

    def client(settings: ZenohSettings, wait_s: float) -> str:
        with open_session(at_endpoint(settings), RobotSettings(), StopFlag(), wait_s) as session:
            wait_until(session.info.routers_zid)
            return "in"

    member = issue(ours, "worker", "clientAuth")
    stranger = msgspec.structs.replace(
        issue(strangers, "stranger", "clientAuth"), tls_ca_certificate=str(ours)
    )
    nobody = ZenohSettings(tls_ca_certificate=str(ours))
    with open_router(at_endpoint(issue(ours, "router", "serverAuth"))):
        assert client(member, 20.0) == "in"
        for outsider in (stranger, nobody):
            with pytest.raises(UnreachableError):
                client(outsider, 1.0)
