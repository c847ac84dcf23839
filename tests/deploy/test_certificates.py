import re
import shutil
import stat
import subprocess
from datetime import timedelta
from pathlib import Path

import pytest

from clustermcl.link.access_control import ROLES
from clustermcl.runtime.settings_file import load_settings
from tests.integration.security import certificates

certificates.require_openssl()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with certificates of a router, a worker, and a viewer of one robot."""
    folder = tmp_path_factory.mktemp("certificates")
    hosts = ("--host", "router.example", "--host", "192.0.2.7")
    ran = certificates.make_certificates(folder, *hosts, "router", "worker-3", "viewer.r-7")
    assert (ran.returncode, ran.stderr) == (0, "")
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "certificates")


def about(certificate: Path, *options: str) -> str:
    command = ["openssl", "x509", "-in", str(certificate), "-noout", *options]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_only_its_owner_may_read_a_private_key(made: Path) -> None:
    modes = {file.name: stat.S_IMODE(file.stat().st_mode) for file in made.glob("*.key")}
    names = ("authority", "router", "worker-3", "viewer.r-7")
    assert modes == {f"{name}.key": 0o600 for name in names}


def test_the_router_is_known_by_its_hosts_and_cannot_pose_as_a_client(made: Path) -> None:
    text = about(made / "router.pem", "-ext", "subjectAltName,extendedKeyUsage")
    for name in ("DNS:localhost", "IP Address:127.0.0.1", "DNS:router.example", "192.0.2.7"):
        assert name in text
    assert "TLS Web Server Authentication" in text
    assert "Client" not in text
    client = about(made / "worker-3.pem", "-ext", "extendedKeyUsage")
    assert "TLS Web Client Authentication" in client
    assert "Server" not in client


def test_the_settings_of_a_client_load_and_name_its_robot(made: Path) -> None:
    settings = load_settings(made / "viewer.r-7.toml", [])
    assert settings.robot.name == "r-7"
    assert settings.zenoh.router == "tls/router.example:7447"
    assert Path(settings.zenoh.tls_private_key) == made / "viewer.r-7.key"
    assert not (made / "router.toml").exists()


@pytest.mark.parametrize(
    ("words", "renewed"),
    [
        (["router", "worker-3", "viewer.r-7"], []),
        (["--renew-before", "400", "--days", "500", "router"], ["router"]),
        (["--host", "other.example", "router"], ["router"]),
        (["--force", "worker-3"], ["worker-3"]),
    ],
    ids=["valid", "expires soon", "another host", "forced"],
)
def test_a_second_run_makes_only_what_is_needed_and_keeps_hosts_and_settings(
    folder: Path, words: list[str], renewed: list[str]
) -> None:
    (folder / "worker-3.toml").write_text("[worker]\ncount = 3\n")
    before = {file: file.read_bytes() for file in folder.iterdir()}
    ran = certificates.make_certificates(folder, *words)
    assert re.findall("(.*): made", ran.stdout) == renewed
    changed = {file.name for file, content in before.items() if file.read_bytes() != content}
    assert changed == {f"{name}.{kind}" for name in renewed for kind in ("pem", "key")}
    host = "other.example" if "--host" in words else "router.example"
    assert f"DNS:{host}" in about(folder / "router.pem", "-ext", "subjectAltName")


def test_a_key_that_does_not_fit_its_certificate_is_replaced(folder: Path) -> None:
    shutil.copy(folder / "router.key", folder / "worker-3.key")
    assert "worker-3: made" in certificates.make_certificates(folder, "worker-3").stdout


def test_the_list_marks_expired_certificates(folder: Path) -> None:
    certificates.with_lifetime(folder, "worker-3", -timedelta(days=9), -timedelta(days=1))
    lines = certificates.make_certificates(folder, "--list").stdout.splitlines()
    printed = dict(line.split(": ", 1) for line in lines)
    assert printed["worker-3"].endswith("(expired)")
    assert printed["router"].endswith("GMT")


def test_without_the_authoritys_key_nothing_is_made(folder: Path) -> None:
    (folder / "authority.key").unlink()
    ran = certificates.make_certificates(folder, "worker-4")
    assert ran.returncode == 2
    assert "authority.key is missing" in ran.stderr


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ([], "no NAME given"),
        (["admin"], "'admin' is no role"),
        (["ros2-a"], "'ros2-a' is no role: router, robot, bridge, coordinator, ros2, viewer,"),
        (["bridge.r/7"], "'bridge.r/7' is no role"),
        (["viewer." + "x" * 60], "at most 64 letters"),
        (["--days", "0", "bridge"], "--days 0: give a number of days"),
        (["--days", "20", "bridge"], "give --renew-before with fewer days as well"),
        (["--host", "a b", "router"], "--host a b: give a DNS name or an IP address"),
        (["--strict", "bridge"], "unknown option --strict"),
    ],
)
def test_a_wrong_argument_is_reported_in_one_line(
    tmp_path: Path, words: list[str], expected: str
) -> None:
    ran = certificates.make_certificates(tmp_path / "new", *words)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert expected in ran.stderr
    assert ran.stderr.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_the_script_has_the_roles_of_the_access_control() -> None:
    roles = re.search(r"^readonly ROLES='(.*)'$", certificates.SCRIPT.read_text(), re.MULTILINE)
    assert roles is not None
    assert sorted(roles[1].split()) == sorted(ROLES)
    usage = certificates.make_certificates(Path(), "--help").stdout.partition("Makes NAME.pem")[0]
    assert set(ROLES) <= set(re.findall(r"[a-z0-9]+", usage))
