"""A worker's certificate lets it answer a coordinator, and neither depose nor dictate to it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh

from clustermcl.client import Client
from process_runtime.settings import CoordinatorSettings, RobotSettings, Settings
from process_runtime.settings_table import settings_as_toml
from process_runtime.stop import StopFlag
from process_runtime.supervisor import python_module
from protocol import keys
from protocol.codec import decode, encode
from protocol.message import Message
from protocol.work import Checkpoint, OrderAnswer, TakeOver, WorkerState, WorkOrder
from tests.integration.processes import RunningProcess
from tests.integration.security.certificates import client_with, require_openssl
from tests.integration.waiting import PATIENCE_S, patient_client, wait_until
from zenoh_link.session import open_session

require_openssl()

LIAR = "worker-a-0"


class LyingWorker:
    """Says that a later term rules."""

    def __init__(self, session: zenoh.Session) -> None:
        state = Checkpoint(sender=LIAR, term=2**52, serial=1, step=0, founded=True, state=b"")
        session.put(keys.CHECKPOINT, encode(state))  # the router drops it
        self.asked: list[TakeOver] = []
        self.ordered: list[WorkOrder] = []
        session.declare_queryable(keys.worker_state(LIAR), self._on_state)
        session.declare_queryable(keys.worker_order(LIAR), self._on_order)
        self._token = session.liveliness().declare_token(keys.worker_alive(LIAR))

    def _on_state(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        self.asked.append(decode(query.payload.to_bytes(), TakeOver))
        term = self.asked[-1].term + 1
        self._answer(
            query,
            WorkerState(sender=LIAR, term=term, holds=(), reports=()),
        )

    def _on_order(self, query: zenoh.Query) -> None:
        assert query.payload is not None
        order = decode(query.payload.to_bytes(), WorkOrder)
        self._answer(
            query,
            OrderAnswer(sender=LIAR, order=order.order, jobs=(), term=order.term + 1),
        )
        self.ordered.append(order)

    @staticmethod
    def _answer(query: zenoh.Query, message: Message) -> None:
        query.reply(query.key_expr, encode(message))


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
    command = python_module("coordinator", "--settings", str(file))
    process = RunningProcess(command, tmp_path, "coordinator")
    yield process
    process.kill()


def test_a_lying_worker_neither_deposes_the_coordinator_nor_dictates_its_belief(
    certificates: Path, secure_endpoint: str, coordinator: RunningProcess
) -> None:
    zenoh_settings = client_with(certificates, "worker-a", secure_endpoint)
    viewer = Settings(zenoh=client_with(certificates, "viewer", secure_endpoint))
    with open_session(zenoh_settings, RobotSettings(), StopFlag(), wait_s=PATIENCE_S) as session:
        liar = LyingWorker(session)
        coordinator.wait_for("coordinator ready")
        wait_until(lambda: len(liar.asked) >= 1 and len(liar.ordered) >= 1)
        with Client(patient_client(viewer)) as client:
            first = liar.ordered[0].term
            wait_until(lambda: client.status().term > first)  # it rises above the claim
            assert client.status().term < 2**52, "a worker's state is not that of a coordinator"
    assert coordinator.is_running()
    assert "stepping down" not in coordinator.err
