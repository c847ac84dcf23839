"""The whole system behind mutual TLS and access control, as real processes with their roles."""

import json
import math
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clustermcl.client import Client
from process_runtime.settings_file import load_settings
from process_runtime.settings_table import settings_as_toml
from process_runtime.stop import StopFlag
from process_runtime.supervisor import python_module
from protocol import keys
from protocol.codec import decode
from protocol.steps import TruePose
from robot_simulator.worlds.catalogue import world
from tests.integration.free_port import free_port
from tests.integration.processes import RunningProcess
from tests.integration.security.certificates import client_with, require_openssl
from tests.integration.system.commands import COMMAND
from tests.integration.system.conftest import SMALL
from tests.integration.waiting import PATIENCE_S, patient_client, wait_until
from zenoh_link.session import open_session

require_openssl()

STEPS = 80
HALL = msgspec.structs.replace(
    SMALL, bridge=msgspec.structs.replace(SMALL.bridge, source="sim:hall")
)


class SecureStack:
    """Router, simulated robot, two workers and coordinator, each with its role's certificate."""

    def __init__(self, certificates: Path, folder: Path) -> None:
        self._certificates, self._folder = certificates, folder
        self._endpoint = f"tls/localhost:{free_port()}"
        self._processes: list[RunningProcess] = []

    def settings_of(self, name: str) -> Path:
        """Settings file of a process or person with the certificate of this name."""
        worker = msgspec.structs.replace(HALL.worker, cache_folder=str(self._folder / "cache"))
        zenoh = client_with(self._certificates, name, self._endpoint)
        settings = msgspec.structs.replace(HALL, zenoh=zenoh, worker=worker)
        file = self._folder / f"{name}.toml"
        file.write_text(settings_as_toml(settings))
        return file

    def start(self) -> None:
        """Start everything, the router first, with a configuration as it is deployed."""
        listen, folder = ("--listen", self._endpoint), ("--certificates", str(self._certificates))
        workers = ("--worker", "worker-a", "--worker", "worker-b")
        command = python_module("zenoh_link.secure_router", *listen, *folder, *workers)
        written = subprocess.run(command, capture_output=True, text=True, check=True)
        configuration = self._folder / "router.json5"
        configuration.write_text(written.stdout)
        self._start("router", "zenoh_link.router", "--config", str(configuration))
        self._processes[0].wait_for("router listens at")
        for name in ("worker-a", "worker-b"):
            self._start_client(name, "worker", "--name", name, "--count", "1")
        self._start_client("bridge", "robot_simulator", "--steps", str(STEPS))
        self.coordinator = self._start_client("coordinator", "coordinator")

    def typed(self, name: str, *words: str) -> subprocess.CompletedProcess[str]:
        """A command of a person with the certificate of this name."""
        command = [*COMMAND, *words, "--settings", str(self.settings_of(name))]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=PATIENCE_S, check=False
        )

    def end(self) -> None:
        """End all processes."""
        for process in reversed(self._processes):
            process.kill()

    def start_standby(self) -> RunningProcess:
        """Start a second coordinator, with the same certificate; returns once it stands by."""
        words = ("--settings", str(self.settings_of("coordinator")), "--standby")
        process = self._start("standby", "coordinator", "--name", "standby", *words)
        process.wait_for("standing by")
        return process

    def _start_client(self, name: str, module: str, *words: str) -> RunningProcess:
        return self._start(name, module, "--settings", str(self.settings_of(name)), *words)

    def _start(self, name: str, module: str, *words: str) -> RunningProcess:
        process = RunningProcess(python_module(module, *words), self._folder, name)
        self._processes.append(process)
        return process


@pytest.fixture(scope="module")
def stack(certificates: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SecureStack]:
    """A running system."""
    made = SecureStack(certificates, tmp_path_factory.mktemp("stack"))
    try:
        made.start()
        yield made
    finally:
        made.end()


def test_a_viewer_sees_the_robot_localized_by_two_workers(stack: SecureStack) -> None:
    viewer = load_settings(stack.settings_of("viewer"), [])
    truths: list[TruePose] = []
    with open_session(viewer.zenoh, viewer.robot, StopFlag(), wait_s=PATIENCE_S) as session:
        session.declare_subscriber(
            keys.TRUTH, lambda sample: truths.append(decode(sample.payload.to_bytes(), TruePose))
        )

        def answer() -> dict[str, Any]:
            return dict(json.loads(stack.typed("viewer", "pose", "--json").stdout or "{}"))

        wait_until(lambda: truths and truths[-1].step == STEPS - 1)
        wait_until(lambda: answer().get("step") == STEPS - 1)
    asked = answer()
    assert asked["state"] == "localized"
    found, true = asked["pose"], truths[-1].map_from_robot
    assert math.hypot(found["x_m"] - true[0], found["y_m"] - true[1]) < 0.5
    status = json.loads(stack.typed("viewer", "status", "--json").stdout)
    assert set(status["workers"]) == {"worker-a-0", "worker-b-0"}
    assert status["steps_lost"] == 0


def test_a_viewer_gets_the_map(stack: SecureStack) -> None:
    with Client(patient_client(load_settings(stack.settings_of("viewer"), []))) as viewer:
        assert viewer.map().digest == world("hall").map.digest


@pytest.mark.parametrize("command", [("relocalize",), ("set-pose", "1", "2", "0")])
def test_a_viewer_cannot_command_and_gets_the_reason(
    stack: SecureStack, command: tuple[str, ...]
) -> None:
    tried = stack.typed("viewer", *command)
    assert tried.returncode == 3
    assert "does this certificate's role allow it?" in tried.stderr
    assert len(tried.stderr.splitlines()) == 1


def test_a_worker_may_not_even_ask_for_the_pose(stack: SecureStack) -> None:
    tried = stack.typed("worker-a", "pose")
    assert tried.returncode == 3
    assert "does this certificate's role allow it?" in tried.stderr


def test_a_coordinator_in_reserve_takes_over_with_the_belief(stack: SecureStack) -> None:
    before = json.loads(stack.typed("viewer", "hypotheses", "--json").stdout)
    standby = stack.start_standby()
    stack.coordinator.kill()
    standby.wait_for("taking over")

    def after() -> dict[str, Any]:
        return dict(json.loads(stack.typed("viewer", "hypotheses", "--json").stdout or "{}"))

    wait_until(lambda: after().get("hypotheses") == before["hypotheses"])


def test_an_operator_may_command(stack: SecureStack) -> None:
    told = stack.typed("operator", "relocalize")
    assert (told.returncode, told.stderr) == (0, "")


def test_a_missing_certificate_is_reported_in_one_line(stack: SecureStack) -> None:
    tried = stack.typed("nobody", "pose")
    assert tried.returncode == 2
    assert tried.stderr.count("\n") == 1
    assert "zenoh.tls_certificate = " in tried.stderr
    assert "nobody.pem': no such file" in tried.stderr
