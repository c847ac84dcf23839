"""The systemd units at work: installed by the words of docs/operations.md on a booted Debian.

Minutes, as root, with Debian's mirror: `pytest -m boots tests/deploy --log-cli-level=info -x`. The
tests build on each other, in this order. The Debian is made once and used again where
CLUSTERMCL_DEBIAN names the folder for it.
"""

import json
import logging
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.deploy.nspawn import ROOT, CannotBootError, Machine, lay_sources, make_debian
from tests.integration.waiting import wait_until

_log = logging.getLogger(__name__)

pytestmark = [pytest.mark.boots, pytest.mark.timeout(1800)]

SERVICES = ("router", "bridge", "coordinator", "worker@1")
SETTINGS = "/etc/clustermcl/settings.toml"
COMMAND = "/opt/clustermcl/bin/clustermcl"
BACK_WITHIN_S = 120.0
ROBOT = """
[Unit]
StartLimitIntervalSec=0
[Service]
WorkingDirectory=/opt/robot-driver
ExecStart=/opt/clustermcl/bin/python -m tests.soak.driver --settings ${DRIVER} --world hall
Environment=DRIVER=/etc/clustermcl/settings.toml
EnvironmentFile=-/etc/clustermcl/driver
Restart=always
RestartSec=1
[Install]
WantedBy=multi-user.target
"""
EDIT = """
mkdir /opt/robot-driver
cp --recursive tests /opt/robot-driver
env --chdir=/opt/robot-driver /opt/clustermcl/bin/python -c 'from pathlib import Path
from clustermcl.simulator.worlds.catalogue import world
from tests.maps import write_map
write_map(world("hall").map, Path("/etc/clustermcl"), "map")'
sed --in-place 's/^count = .*/count = 4/' /etc/clustermcl/settings.toml
systemctl enable --now robot-driver
"""
"""What a person does to the settings, and a robot."""


def words(page: str, after: str) -> str:
    found = re.search(r"^( *)```bash\n(.*?)^ *```", page_after(page, after), re.DOTALL | re.M)
    assert found is not None
    return found[2]


def page_after(page: str, after: str) -> str:
    return (ROOT / "docs" / page).read_text().split(after, 1)[1]


class Robot(Machine):
    """The machine with the product on it, and what is asked of it."""

    settings = SETTINGS

    def ask(self, question: str) -> dict[str, Any]:
        output = self.run(f"{COMMAND} {question} --json --settings {self.settings}", check=False)
        answer: dict[str, Any] = json.loads(output) if output.startswith("{") else {}
        return answer

    def localizes(self, since_step: int = 0) -> bool:
        """Whether it knows its place from fresh scans, and steps go on."""
        pose = self.ask("pose")
        known = pose.get("state") == "localized" and pose["freshness"] == "fresh"
        return known and pose["step"] > since_step and pose["workers"] == 4

    def comes_back(self, what: str, begin_s: float, since_step: int = 0) -> None:
        try:
            wait_until(lambda: self.localizes(since_step), deadline_s=300.0)
        except pytest.fail.Exception:
            _log.info(self.run(f"{COMMAND} status --settings {self.settings}", check=False))
            _log.info(self.run("journalctl --lines=80 --no-pager"))
            raise
        _log.info("%s: localizes again after %.1f s", what, time.monotonic() - begin_s)

    def main_pid(self, service: str) -> int:
        return int(self.run(f"systemctl show --property=MainPID --value clustermcl-{service}"))

    def is_active(self, service: str) -> bool:
        return self.run(f"systemctl is-active clustermcl-{service}", check=False) == "active\n"

    def journal(self) -> str:
        return self.run("journalctl --boot --no-pager --unit 'clustermcl-*'")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    kept = os.environ.get("CLUSTERMCL_DEBIAN", "")
    made = Path(kept) if kept else tmp_path_factory.mktemp("debian") / "made"
    machine = Robot(tmp_path_factory.mktemp("robot") / "root")
    try:
        if not made.exists():
            make_debian(made)
        subprocess.run(["cp", "--archive", made, machine.folder], check=True)  # devices, too
        lay_sources(machine.folder)
        (machine.folder / "etc/systemd/system/robot-driver.service").write_text(ROBOT)
        (machine.folder / "etc/hosts").write_text("127.0.0.1 localhost robot.example\n")
        machine.boot()
        yield machine
    except CannotBootError as why:
        pytest.skip(f"no Debian can be booted here: {why}")
    finally:
        machine.cut_power()
        for folder in (machine.folder, *([] if kept else [made])):
            shutil.rmtree(folder, ignore_errors=True)


def test_the_commands_of_the_page_install_the_service(robot: Robot) -> None:
    script = words("operations.md", "**systemd**, as root")
    before, edited, after = script.partition("# edit robot.name and bridge.map")
    assert edited
    robot.run(before + EDIT)
    begin_s = time.monotonic()
    robot.run(after)
    robot.comes_back("first start, which compiles", begin_s)
    for service in SERVICES:
        assert robot.is_active(service)


@pytest.mark.parametrize("service", SERVICES)
def test_a_service_that_is_killed_comes_back(robot: Robot, service: str) -> None:
    step, pid = robot.ask("pose")["step"], robot.main_pid(service)
    begin_s = time.monotonic()
    robot.run(f"kill -KILL {pid}")
    wait_until(lambda: robot.main_pid(service) not in (0, pid), BACK_WITHIN_S)
    wait_until(lambda: robot.is_active(service), BACK_WITHIN_S)
    _log.info("%s: back after %.1f s", service, time.monotonic() - begin_s)
    robot.comes_back(f"{service} killed", begin_s, step)


def test_a_service_that_hangs_is_ended_and_comes_back(robot: Robot) -> None:
    step, pid = robot.ask("pose")["step"], robot.main_pid("bridge")
    begin_s = time.monotonic()
    robot.run(f"kill -STOP {pid}")
    wait_until(lambda: robot.main_pid("bridge") not in (0, pid), BACK_WITHIN_S)
    assert "Watchdog timeout" in robot.journal()
    robot.comes_back("bridge frozen", begin_s, step)


def test_each_process_has_the_rights_of_its_unit_and_no_more(robot: Robot) -> None:
    for service in SERVICES:
        status = robot.run(f"cat /proc/{robot.main_pid(service)}/status")
        facts = dict(line.split(":\t", 1) for line in status.splitlines() if ":\t" in line)
        assert facts["Uid"].split()[0] != "0"
        assert (facts["CapEff"], facts["CapBnd"]) == ("0" * 16, "0" * 16)
        assert (facts["NoNewPrivs"], facts["Seccomp"]) == ("1", "2")
    for complaint in ("denied", "not permitted", "cannot be kept", "cannot be used", "Traceback"):
        assert complaint not in robot.journal()
    assert robot.run("ls /var/lib/clustermcl/flight-recorder/robot")


def test_the_service_starts_with_the_machine_and_after_a_power_cut(robot: Robot) -> None:
    begin_s = time.monotonic()
    robot.reboot()
    robot.comes_back("shut down and booted", begin_s)
    begin_s = time.monotonic()
    robot.cut_power()
    robot.boot()
    robot.comes_back("power cut and boot", begin_s)
    assert "a bug ended" not in robot.journal()


def test_the_commands_of_the_page_upgrade_the_service(robot: Robot) -> None:
    robot.run("sed --in-place 's/^version = .*/version = \"0.1.99\"/' pyproject.toml")
    step = robot.ask("pose")["step"]
    begin_s = time.monotonic()
    robot.run(words("operations.md", "This order costs least"))
    robot.comes_back("upgrade, pip included", begin_s, step)
    versions = {process["version"] for process in robot.ask("status")["processes"]}
    assert versions == {"0.1.99"}
    assert "count = 4" in robot.run(f"cat {SETTINGS}")


def test_with_certificates_the_robot_is_localized_and_a_withdrawn_one_is_refused(
    robot: Robot,
) -> None:
    certificates = "/etc/clustermcl/certificates"
    robot.run(
        f"deploy/certificates.sh --folder {certificates} --host robot.example "
        "router robot bridge coordinator worker-1 worker-1b viewer\n"
        f"mv {certificates}/authority.key /root\n"
        f"sed --in-place 's|^router = .*|router = \"tls/robot.example:7447\"|' {SETTINGS}\n"
        f"echo DRIVER={certificates}/robot.toml > /etc/clustermcl/driver"
    )
    write_router_file(robot, "worker-1")
    begin_s = time.monotonic()
    robot.run(words("operations.md", "2. On the robot:"))
    robot.run("systemctl restart robot-driver")
    robot.settings = f"{certificates}/viewer.toml"
    robot.comes_back("restart with certificates", begin_s)
    write_router_file(robot, "worker-1b")
    robot.run("systemctl restart clustermcl-router")
    wait_until(lambda: robot.ask("status").get("workers") == {}, 60.0)
    assert robot.is_active("worker@1"), "it has a link, and may do nothing"
    begin_s = time.monotonic()
    robot.run("systemctl start clustermcl-worker@1b")
    robot.comes_back("workers with a new certificate", begin_s)
    assert all(name.startswith("worker-1b-") for name in robot.ask("status")["workers"])


def write_router_file(robot: Robot, worker: str) -> None:
    robot.run(
        "/opt/clustermcl/bin/python -I -m clustermcl.link.secure_router --certificates"
        f" /run/credentials/clustermcl-router.service --worker {worker}"
        " > /etc/clustermcl/router-secure.json5"
    )
