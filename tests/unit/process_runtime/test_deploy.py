"""What an administrator copies must start what there is to start."""

import configparser
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from process_runtime.settings_file import load_settings

REPOSITORY = Path(__file__).parents[3]
DEPLOY = REPOSITORY / "deploy"
UNITS = DEPLOY / "systemd"
SERVICES = sorted(UNITS.glob("*.service"))


def commands_of_units() -> list[list[str]]:
    commands = []
    for file in SERVICES:
        unit = configparser.ConfigParser(interpolation=None)
        unit.read(file)
        commands.append(unit["Service"]["ExecStart"].split()[3:])
    return commands


def commands_of_compose() -> list[list[str]]:
    compose = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
    return [service["command"] for service in compose["services"].values()]


@pytest.mark.parametrize("command", commands_of_units() + commands_of_compose(), ids=" ".join)
def test_every_command_runs_a_module_of_ours_with_files_that_are_deployed(
    command: list[str],
) -> None:
    module, *arguments = command
    spec = importlib.util.find_spec(module)
    assert spec is not None
    if spec.submodule_search_locations is not None:  # a package is run by its __main__
        assert importlib.util.find_spec(f"{module}.__main__") is not None
    files = [argument for argument in arguments if argument.startswith("/etc/clustermcl/")]
    assert files
    for file in files:
        assert (DEPLOY / Path(file).name).is_file()


def test_all_four_processes_are_deployed_both_ways() -> None:
    processes = {"process_runtime.router", "sensor_bridge", "coordinator", "worker"}
    assert {command[0] for command in commands_of_units()} == processes
    assert {command[0] for command in commands_of_compose()} == processes


def test_the_example_settings_are_settings() -> None:
    assert load_settings(DEPLOY / "settings.toml", []).worker.count == 12


def test_systemd_finds_no_fault_with_the_units(tmp_path: Path) -> None:
    systemd_analyze = shutil.which("systemd-analyze")
    if systemd_analyze is None:
        pytest.skip("systemd-analyze is not installed")
    units = shutil.copytree(UNITS, tmp_path / "units")
    for file in units.glob("*.service"):
        text = re.sub("ExecStart=[^ ]+", f"ExecStart={sys.executable}", file.read_text())
        file.write_text(text)
    ran = subprocess.run(
        [systemd_analyze, "verify", "--man=no", *map(str, sorted(units.glob("*.*[et]")))],
        env={"SYSTEMD_UNIT_PATH": f"{units}:"},
        capture_output=True,
        text=True,
        check=False,
    )
    faults = [line for line in ran.stderr.splitlines() if str(units) in line or ".conf" in line]
    assert (ran.returncode, faults) == (0, [])
