"""A worker's certificate lets it answer a coordinator, and neither depose nor dictate to it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from clustermcl.client import Client
from clustermcl.link.session import open_session
from clustermcl.protocol import keys
from clustermcl.protocol.codec import encode
from clustermcl.protocol.work import Checkpoint
from clustermcl.runtime.settings import CoordinatorSettings, RobotSettings, Settings
from clustermcl.runtime.settings_table import settings_as_toml
from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import python_module
from tests.integration.processes import RunningProcess
from tests.integration.security.certificates import client_with, require_openssl
from tests.integration.untrue_worker import UntrueWorker
from tests.integration.waiting import PATIENCE_S, patient_client, wait_until

require_openssl()

LIAR = "worker-a-0"


@pytest.fixture
def coordinator(
    certificates: Path, secure_endpoint: str, tmp_path: Path
) -> Iterator[RunningProcess]:
    settings = Settings(
        zenoh=client_with(certificates, "coordinator", secure_endpoint),
        coordinator=CoordinatorSettings(state_folder="off"),
    )
    file = tmp_path / "settings.toml"
    file.write_text(settings_as_toml(settings))
    command = python_module("clustermcl.coordinator", "--settings", str(file))
    process = RunningProcess(command, tmp_path, "coordinator")
    yield process
    process.kill()


def test_a_lying_worker_neither_deposes_the_coordinator_nor_dictates_its_belief(
    certificates: Path, secure_endpoint: str, coordinator: RunningProcess
) -> None:
    zenoh_settings = client_with(certificates, "worker-a", secure_endpoint)
    viewer = Settings(zenoh=client_with(certificates, "viewer", secure_endpoint))
    with open_session(zenoh_settings, RobotSettings(), StopFlag(), wait_s=PATIENCE_S) as session:
        state = Checkpoint(sender=LIAR, term=2**52, serial=1, step=0, founded=True, state=b"")
        session.put(keys.CHECKPOINT, encode(state))  # the router drops it
        liar = UntrueWorker(session, LIAR, lift=1)
        coordinator.wait_for("coordinator ready")
        wait_until(lambda: len(liar.asked) >= 1 and len(liar.ordered) >= 1)
        with Client(patient_client(viewer)) as client:
            first = liar.ordered[0].term
            wait_until(lambda: client.status().term > first)  # it rises above the claim
            assert client.status().term < 2**52, "a worker's state is not that of a coordinator"
    assert coordinator.is_running()
    assert "stepping down" not in coordinator.err
