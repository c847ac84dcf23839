"""A worker that waits for its map still answers queries and other orders."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from clustermcl.link.node import Node
from clustermcl.link.wire import ask, ask_later
from clustermcl.protocol import keys
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.health import Health
from clustermcl.protocol.steps import ScanHistory
from clustermcl.protocol.work import OrderAnswer, WorkOrder
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.worker.process import WorkerLoop
from tests.integration.conftest import OpenClient
from tests.integration.running import running
from tests.integration.waiting import answered, stretched_s, wait_until
from tests.unit.worker.test_job_table import cloud, track

NAME = "worker-0"
SOON_S = 5.0
MAP = world("cross").map


class Bridge:
    """Holds back queries for the map until released; has no past scans."""

    def __init__(self, session: zenoh.Session) -> None:
        self.asked: list[zenoh.Query] = []
        session.declare_queryable(keys.MAP, self.asked.append, complete=True)
        session.declare_queryable(keys.SCAN_HISTORY, self._answer_scans, complete=True)

    def answer(self) -> None:
        while self.asked:
            with self.asked.pop() as query:
                query.reply(query.key_expr, encode(to_message(MAP, "bridge")))

    def _answer_scans(self, query: zenoh.Query) -> None:
        with query:
            query.reply(keys.SCAN_HISTORY, encode(ScanHistory(sender="bridge", scans=())))


class Coordinator:
    """Sends orders without waiting and collects the worker's reports."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self.answers: dict[int, OrderAnswer] = {}
        self.healths: list[Health] = []
        session.declare_subscriber(
            keys.worker_health(NAME),
            lambda sample: self.healths.append(decode(sample.payload.to_bytes(), Health)),
        )

    def order(self, number: int, *jobs: str) -> None:
        begin = tuple(track(job, cloud()) for job in jobs)
        message = WorkOrder(
            sender="coordinator", order=number, map_digest=MAP.digest, filter_settings={},
            snapshot_every_steps=0, keep=(), begin=begin,
        )  # fmt: skip
        ask_later(
            self.session,
            keys.worker_order(NAME),
            lambda got: self.answers.update({number: decode(got.payload, OrderAnswer)}),
            lambda _refused: None,
            timeout_s=60.0,
            message=message,
        )

    def state(self) -> OrderAnswer:
        key = keys.worker_state(NAME)
        return ask(self.session, key, OrderAnswer, timeout_s=stretched_s(SOON_S))


@pytest.fixture
def bridge(router: ZenohSettings, open_client: OpenClient) -> Bridge:
    del router
    return Bridge(open_client())


@pytest.fixture
def coordinator(
    bridge: Bridge, router: ZenohSettings, open_client: OpenClient, tmp_path: Path
) -> Iterator[Coordinator]:
    """Of a worker whose loop runs in a thread."""
    del bridge
    settings = replace(Settings(), zenoh=router)

    def work(stop: StopFlag) -> None:
        peers = keys.COORDINATOR_ALIVE
        with closing(Node(NAME, "worker", settings, stop, peers=peers)) as node:
            node.open()
            WorkerLoop(node, tmp_path, lambda _jobs: None).run()

    made = Coordinator(open_client())
    with running(work):
        answered(made.session, keys.worker_state(NAME), OrderAnswer)
        yield made


def test_a_worker_that_waits_for_its_map_answers_queries_and_other_orders(
    bridge: Bridge, coordinator: Coordinator
) -> None:
    coordinator.order(1, "c0")
    wait_until(lambda: bridge.asked)
    assert coordinator.state().jobs == ()
    assert 1 not in coordinator.answers, "it is not done"
    received = len(coordinator.healths)
    wait_until(lambda: len(coordinator.healths) > received + 1)
    coordinator.order(2)
    wait_until(lambda: {1, 2} <= coordinator.answers.keys(), stretched_s(SOON_S))
    assert (coordinator.answers[1].order, coordinator.answers[2].order) == (0, 2)
    assert len(bridge.asked) == 1
    bridge.answer()
    coordinator.order(3, "c1")
    wait_until(lambda: bridge.asked or 3 in coordinator.answers)
    bridge.answer()
    wait_until(lambda: 3 in coordinator.answers)
    assert [job for job, _, _ in coordinator.answers[3].jobs] == ["c1"], "c0 was taken back"
