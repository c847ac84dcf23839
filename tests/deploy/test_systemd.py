import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from clustermcl.runtime.settings_file import load_settings

DEPLOY = Path(__file__).parents[2] / "deploy"
UNITS, SECURE = DEPLOY / "systemd", DEPLOY / "systemd-secure"
SERVICES = sorted(UNITS.glob("*.service"))
MOST_EXPOSURE = 1.5
"""Of 10; below 2 systemd calls a service OK or better."""


@pytest.mark.parametrize("file", SERVICES, ids=lambda file: file.stem)
def test_every_unit_runs_a_process_of_ours_with_its_arguments_and_deployed_files(
    file: Path,
) -> None:
    (command,) = re.findall("^ExecStart=(.*)$", file.read_text(), re.MULTILINE)
    module, *arguments = command.split()[3:]
    files = [argument for argument in arguments if argument.startswith("/etc/clustermcl/")]
    assert files
    assert all((DEPLOY / Path(file).name).is_file() for file in files)
    known = subprocess.run(
        [sys.executable, "-I", "-m", module, "--help"], capture_output=True, text=True, check=True
    ).stdout
    assert all(not word.startswith("--") or word in known for word in arguments)


def test_the_example_settings_are_settings() -> None:
    assert load_settings(DEPLOY / "settings.toml", []).worker.count == 0


def installed(folder: Path, *, secure: bool) -> Path:
    """The units as they would be installed, with a Python that is here."""
    units = shutil.copytree(UNITS, folder / "units")
    if secure:
        shutil.copytree(SECURE, units, dirs_exist_ok=True)
    shutil.copy(units / "clustermcl-worker@.service", units / "clustermcl-worker@1.service")
    for file in [*units.glob("*.service"), *units.glob("*/*.conf")]:
        text = re.sub("ExecStart=/[^ ]+", f"ExecStart={sys.executable}", file.read_text())
        file.write_text(text)
    return units


def systemd_analyze(units: Path, *words: str) -> subprocess.CompletedProcess[str]:
    if (found := shutil.which("systemd-analyze")) is None:
        pytest.skip("systemd-analyze is not installed")
    paths = {"SYSTEMD_UNIT_PATH": f"{units}:"}
    return subprocess.run([found, *words], env=paths, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("secure", [False, True], ids=["plain", "secure"])
def test_systemd_finds_no_fault_with_the_units(tmp_path: Path, *, secure: bool) -> None:
    units = installed(tmp_path, secure=secure)
    files = sorted(map(str, units.glob("*.*[et]")))
    ran = systemd_analyze(units, "verify", "--man=no", *files)
    faults = [line for line in ran.stderr.splitlines() if str(units) in line or ".conf" in line]
    assert (ran.returncode, faults) == (0, [])


@pytest.mark.parametrize("file", SERVICES, ids=lambda file: file.stem)
def test_systemd_rates_the_exposure_of_each_service_below_the_limit(
    tmp_path: Path, file: Path
) -> None:
    units = installed(tmp_path, secure=True)
    ran = systemd_analyze(units, "security", "--offline=true", "--no-pager", file.name)
    found = re.search(r"Overall exposure level for .*: ([\d.]+)", ran.stdout)
    assert found is not None, ran.stderr
    assert float(found[1]) <= MOST_EXPOSURE


@pytest.mark.parametrize("service", [file.name for file in SERVICES])
def test_systemd_reads_every_drop_in_and_none_masks_another(tmp_path: Path, service: str) -> None:
    units = installed(tmp_path, secure=True)
    for file in units.glob("*/*.conf"):
        file.write_text(f"{file.read_text()}\nUnheardOf=yes\n")
    name = service.replace("@", "@1")
    complaints = systemd_analyze(units, "verify", "--man=no", str(units / name)).stderr
    for read in ("clustermcl-.service.d/common.conf", "clustermcl-.service.d/tls.conf"):
        assert f"{read}:" in complaints
    assert complaints.count(f"{service}.d/secure.conf:") == 1


def test_every_service_gets_the_certificate_of_its_role_and_no_other_key() -> None:
    for file in SERVICES:
        given = (SECURE / f"{file.name}.d" / "secure.conf").read_text()
        keys = re.findall(r"LoadCredential=\S+:/etc/clustermcl/certificates/(\S+)\.key", given)
        role = file.stem.removeprefix("clustermcl-").removeprefix("standby-")
        assert keys == [role.replace("@", "-%i")]
    assert ".key:" not in (SECURE / "clustermcl-.service.d" / "tls.conf").read_text()


def test_the_arguments_for_certificates_are_settings(tmp_path: Path) -> None:
    line = re.search(
        'Environment="CLUSTERMCL_TLS=(.*)"',
        (SECURE / "clustermcl-.service.d" / "tls.conf").read_text(),
    )
    assert line is not None
    words = shlex.split(line[1].replace("%d", str(tmp_path)))
    assert set(words[::2]) == {"--set"}
    zenoh = load_settings(DEPLOY / "settings.toml", words[1::2]).zenoh
    assert Path(zenoh.tls_ca_certificate).name == "authority.pem"
    assert Path(zenoh.tls_certificate).name == "own.pem"
    assert Path(zenoh.tls_private_key).name == "own.key"
