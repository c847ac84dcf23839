import configparser
import importlib.util
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from clustermcl.runtime.settings_file import load_settings
from clustermcl.runtime.supervisor import HUNG_AFTER_S

DEPLOY = Path(__file__).parents[2] / "deploy"
UNITS, SECURE = DEPLOY / "systemd", DEPLOY / "systemd-secure"
SERVICES = sorted(UNITS.glob("*.service"))
GIVEN_LATER = ("$CLUSTERMCL_TLS",)
"""Variables that are empty by default."""
MOST_EXPOSURE = 1.5
"""Of 10; below 2 systemd calls a service OK or better."""


def unit(file: Path) -> configparser.ConfigParser:
    """A unit file; of a key that is given twice, the last."""
    parsed = configparser.ConfigParser(interpolation=None, strict=False)
    parsed.optionxform = str  # type: ignore[assignment,method-assign] # systemd minds the case
    parsed.read(file)
    return parsed


def starts() -> list[list[str]]:
    """Module and arguments of every service, without the variables that are empty by default."""
    commands = [unit(file)["Service"]["ExecStart"].split()[3:] for file in SERVICES]
    return [[word for word in command if word not in GIVEN_LATER] for command in commands]


@pytest.mark.parametrize("command", starts(), ids=" ".join)
def test_every_unit_runs_a_module_of_ours_with_files_that_are_deployed(command: list[str]) -> None:
    module, *arguments = command
    spec = importlib.util.find_spec(module)
    assert spec is not None
    if spec.submodule_search_locations is not None:  # a package is run by its __main__
        assert importlib.util.find_spec(f"{module}.__main__") is not None
    files = [argument for argument in arguments if argument.startswith("/etc/clustermcl/")]
    assert files
    for file in files:
        assert (DEPLOY / Path(file).name).is_file()


@pytest.mark.parametrize("command", starts(), ids=" ".join)
def test_every_process_knows_its_arguments(command: list[str]) -> None:
    known = subprocess.run(
        [sys.executable, "-I", "-m", command[0], "--help"],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    for argument in command[1:]:
        assert not argument.startswith("--") or argument in known


def test_all_but_the_router_start_after_the_router() -> None:
    [shared] = UNITS.glob("clustermcl-.service.d/*.conf")
    assert "clustermcl-router.service" not in unit(shared)["Unit"]["After"], "the router too"
    orders = {file.name: unit(file)["Unit"].get("After") for file in SERVICES}
    assert orders.pop("clustermcl-router.service") is None
    assert set(orders.values()) == {"clustermcl-router.service"}


def test_the_systemd_target_wants_existing_units() -> None:
    wanted = unit(UNITS / "clustermcl.target")["Unit"]["Wants"].split()
    for name in wanted:
        assert (UNITS / re.sub("@[^.]+", "@", name)).is_file()
    processes = {
        unit(UNITS / re.sub("@[^.]+", "@", name))["Service"]["ExecStart"].split()[3]
        for name in wanted
    }
    assert len(processes) == 4


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
    found = shutil.which("systemd-analyze")
    if found is None:
        pytest.skip("systemd-analyze is not installed")
    return subprocess.run(
        [found, *words],
        env={"SYSTEMD_UNIT_PATH": f"{units}:"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("secure", [False, True], ids=["plain", "secure"])
def test_systemd_finds_no_fault_with_the_units(tmp_path: Path, *, secure: bool) -> None:
    units = installed(tmp_path, secure=secure)
    files = sorted(map(str, units.glob("*.*[et]")))
    ran = systemd_analyze(units, "verify", "--man=no", *files)
    faults = [line for line in ran.stderr.splitlines() if str(units) in line or ".conf" in line]
    assert (ran.returncode, faults) == (0, [])


@pytest.mark.parametrize("name", [*(file.name for file in SERVICES), "clustermcl-worker@1.service"])
def test_systemd_rates_the_exposure_of_each_service_below_the_limit(
    tmp_path: Path, name: str
) -> None:
    units = installed(tmp_path, secure=True)
    ran = systemd_analyze(units, "security", "--offline=true", "--no-pager", name)
    found = re.search(r"Overall exposure level for .*: ([\d.]+)", ran.stdout)
    assert found is not None, ran.stderr
    assert float(found[1]) <= MOST_EXPOSURE


def drop_ins(units: Path, service: str) -> list[Path]:
    """Those that systemd reads for a service, in its order (systemd.unit(5)).

    They are sorted by their file names; of equal names the one in the most particular folder
    masks the others.
    """
    stem = service.removesuffix(".service")
    prefixes = [stem[: dash.end()] for dash in re.finditer("-", stem)]
    found: dict[str, Path] = {}
    for name in (*prefixes, stem):
        found |= {file.name: file for file in (units / f"{name}.service.d").glob("*.conf")}
    return [found[name] for name in sorted(found)]


@pytest.mark.parametrize("service", [file.name for file in SERVICES])
def test_no_drop_in_masks_another_and_certificates_come_last(tmp_path: Path, service: str) -> None:
    read = drop_ins(installed(tmp_path, secure=True), service)
    general = {"common.conf", "tls.conf"}
    assert {file.name for file in read if file.parent.name == "clustermcl-.service.d"} == general
    assert [file.name for file in read if file.parent.name == f"{service}.d"] == ["secure.conf"]
    given = "".join(file.read_text() for file in read)
    credentials = set(re.findall(r"LoadCredential=([^:]+):", given))
    assert {name.replace("router", "own") for name in credentials} == {
        *("authority.pem", "own.pem", "own.key")
    }
    arguments = re.findall('Environment="?CLUSTERMCL_TLS=(.*)', given)
    assert "own.key" in arguments[-1]


@pytest.mark.parametrize("service", [file.name for file in SERVICES])
def test_systemd_reads_every_drop_in(tmp_path: Path, service: str) -> None:
    units = installed(tmp_path, secure=True)
    for file in units.glob("*/*.conf"):
        file.write_text(f"{file.read_text()}\nUnheardOf=yes\n")
    name = service.replace("@", "@1")
    complaints = systemd_analyze(units, "verify", "--man=no", str(units / name)).stderr
    for file in drop_ins(units, service):
        assert f"{file.parent.name}/{file.name}:" in complaints
    assert complaints.count(f"{service}.d/") == 1
    assert "clustermcl-.service.d/tls.conf" in complaints


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
    credentials = [
        text
        for file in SECURE.glob("*/*.conf")
        for text in re.findall(r"LoadCredential=([^:]+):", file.read_text())
    ]
    assert {"authority.pem", "own.pem", "own.key"} <= set(credentials)


def test_systemd_restarts_a_hanging_process_and_gives_the_first_start_time_to_compile() -> None:
    common = unit(UNITS / "clustermcl-.service.d" / "common.conf")["Service"]
    assert (common["Type"], common["Restart"]) == ("notify", "always")
    assert float(common["WatchdogSec"]) == HUNG_AFTER_S, "as for who runs clustermcl up"
    assert float(common["TimeoutStartSec"]) > 120.0
    for file in SERVICES:
        assert not {"Type", "WatchdogSec", "NotifyAccess"} & set(unit(file)["Service"])
