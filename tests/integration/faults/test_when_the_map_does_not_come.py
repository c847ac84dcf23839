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
from clustermcl.protocol.work import OrderAnswer, TakeOver, WorkerState
from clustermcl.recordings.maps.map_message import to_message
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.worker.process import WorkerLoop
from tests.integration.conftest import OpenClient
from tests.integration.running import running
from tests.integration.waiting import answered, stretched_s, wait_until
from tests.unit.coordinator.reports import work_order
from tests.unit.worker.test_job_table import cloud, track

NAME = "worker-0"
SOON_S = 5.0
ASKED = TakeOver(sender="coordinator", term=0)
MAP = world("cross").map


class Others:
    """A bridge that holds back its map until `show_map`, and a coordinator that does not wait."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session, self.asked = session, list[zenoh.Query]()
        self.answers, self.healths = dict[int, OrderAnswer](), list[Health]()
        session.declare_queryable(keys.MAP, self.asked.append, complete=True)
        session.declare_queryable(keys.SCAN_HISTORY, self._no_scans, complete=True)
        session.declare_subscriber(
            keys.worker_health(NAME),
            lambda sample: self.healths.append(decode(sample.payload.to_bytes(), Health)),
        )

    def _no_scans(self, query: zenoh.Query) -> None:
        with query:
            query.reply(keys.SCAN_HISTORY, encode(ScanHistory(sender="bridge", scans=())))

    def show_map(self) -> None:
        while self.asked:
            with self.asked.pop() as query:
                query.reply(query.key_expr, encode(to_message(MAP, "bridge")))

    def order(self, number: int, *jobs: str) -> None:
        begin = tuple(track(job, cloud()) for job in jobs)
        ask_later(
            self.session,
            keys.worker_order(NAME),
            lambda got: self.answers.update({number: decode(got.payload, OrderAnswer)}),
            lambda _refused: None,
            timeout_s=60.0,
            message=work_order(number, map_digest=MAP.digest, begin=begin),
        )


@pytest.fixture
def others(router: ZenohSettings, open_client: OpenClient, tmp_path: Path) -> Iterator[Others]:
    """Of a worker whose loop runs in a thread."""
    made = Others(open_client())

    def work(stop: StopFlag) -> None:
        settings, peers = replace(Settings(), zenoh=router), keys.COORDINATOR_ALIVE
        with closing(Node(NAME, "worker", settings, stop, peers=peers)) as node:
            node.open()
            WorkerLoop(node, tmp_path, lambda _jobs: None).run()

    with running(work):
        answered(made.session, keys.worker_state(NAME), WorkerState, ASKED)
        yield made


def test_a_worker_that_waits_for_its_map_answers_queries_and_other_orders(others: Others) -> None:
    others.order(1, "c0")
    wait_until(lambda: others.asked)
    key, timeout_s = keys.worker_state(NAME), stretched_s(SOON_S)
    state = ask(others.session, key, WorkerState, timeout_s=timeout_s, message=ASKED)
    assert state.holds == ()
    assert 1 not in others.answers, "it is not done"
    received = len(others.healths)
    wait_until(lambda: len(others.healths) > received + 1)
    others.order(2)
    wait_until(lambda: {1, 2} <= others.answers.keys(), stretched_s(SOON_S))
    assert (others.answers[1].order, others.answers[2].order) == (0, 2)
    assert len(others.asked) == 1
    others.show_map()
    others.order(3, "c1")
    wait_until(lambda: others.asked or 3 in others.answers)
    others.show_map()
    wait_until(lambda: 3 in others.answers)
    assert [job for job, _, _ in others.answers[3].jobs] == ["c1"], "c0 was taken back"
