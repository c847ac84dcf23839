"""Certificates for tests: those of `deploy/certificates.sh`, and those that should not get in."""

import os
import shutil
import subprocess
from datetime import UTC, datetime, timedelta
from pathlib import Path

import msgspec
import pytest

from clustermcl.runtime.settings import ZenohSettings

SCRIPT = Path(__file__).resolve().parents[3] / "deploy" / "certificates.sh"


def require_openssl() -> None:
    if shutil.which("openssl") is None or shutil.which("bash") is None:
        pytest.skip(
            "bash and openssl make the certificates; one is missing", allow_module_level=True
        )


def make_certificates(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the script as an administrator does; what it said and how it ended."""
    return subprocess.run(
        [str(SCRIPT), "--folder", str(folder), *words],
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": os.environ["PATH"]},
    )


def client_with(folder: Path, name: str, router: str) -> ZenohSettings:
    return ZenohSettings(
        router=router,
        tls_ca_certificate=str(folder / "authority.pem"),
        tls_certificate=str(folder / f"{name}.pem"),
        tls_private_key=str(folder / f"{name}.key"),
    )


def without_certificate(settings: ZenohSettings) -> ZenohSettings:
    return msgspec.structs.replace(settings, tls_certificate="", tls_private_key="")


def with_lifetime(folder: Path, name: str, begin: timedelta, end: timedelta) -> None:
    """Sign this name's certificate again, for a period near now that may have ended."""
    for file, text in (
        ("index.txt", ""),
        ("serial", f"{os.getrandom(8).hex()}\n"),
        ("extensions", "extendedKeyUsage = clientAuth\n"),
        ("configuration", _configuration(folder)),
    ):
        (folder / file).write_text(text)
    key, request = folder / f"{name}.key", folder / "request.csr"
    _openssl("req", "-new", "-key", str(key), "-subj", f"/CN={name}", "-out", str(request))
    now = datetime.now(UTC)
    _openssl(
        *("ca", "-batch", "-notext", "-config", str(folder / "configuration")),
        *("-cert", str(folder / "authority.pem"), "-keyfile", str(folder / "authority.key")),
        *("-startdate", f"{now + begin:%Y%m%d%H%M%SZ}", "-enddate", f"{now + end:%Y%m%d%H%M%SZ}"),
        *("-extfile", str(folder / "extensions"), "-in", str(request)),
        *("-out", str(folder / f"{name}.pem")),
    )


def _configuration(folder: Path) -> str:
    return (
        f"[ca]\ndefault_ca = it\n[it]\ndatabase = {folder}/index.txt\nserial = {folder}/serial\n"
        f"new_certs_dir = {folder}\ndefault_md = sha256\npolicy = any\nunique_subject = no\n"
        f"[any]\ncommonName = supplied\n"
    )


def _openssl(*words: str) -> None:
    subprocess.run(["openssl", *words], check=True, capture_output=True)
