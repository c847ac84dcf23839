"""A worker that answers every order and question as an honest one does, and computes nothing."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import zenoh

from process_runtime.stop import StopFlag
from protocol import keys
from protocol.codec import decode, encode
from protocol.work import OrderAnswer, TakeOver, WorkerState, WorkOrder
from tests.integration.faults.system import System
from tests.integration.waiting import PATIENCE_S
from zenoh_link.session import open_session


class UntrueWorker:
    """Answers in Zenoh's threads for as long as its session lasts.

    Args:
        session: what it speaks with.
        name: its own.
    """

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self.name = name
        self.had: set[str] = set()
        """Jobs that it was ever given."""
        self._epochs: dict[str, int] = {}
        session.declare_queryable(keys.worker_order(name), self._on_order)
        session.declare_queryable(keys.worker_state(name), self._on_state)
        self._token = session.liveliness().declare_token(keys.worker_alive(name))

    def _on_order(self, query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            order = decode(query.payload.to_bytes(), WorkOrder)
            self._epochs = dict(order.keep) | {one.job_id: one.epoch for one in order.begin}
            self.had |= set(self._epochs)
            answer = OrderAnswer(
                sender=self.name, order=order.order, term=order.term,
                jobs=tuple((job_id, epoch, -1) for job_id, epoch in self._epochs.items()),
            )  # fmt: skip
            query.reply(query.key_expr, encode(answer))

    def _on_state(self, query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            asked = decode(query.payload.to_bytes(), TakeOver)
            told = WorkerState(
                sender=self.name, term=asked.term, holds=(),
                reports=(),
            )  # fmt: skip
            query.reply(query.key_expr, encode(told))


@contextmanager
def untrue_workers(tested: System, *names: str) -> Iterator[list[UntrueWorker]]:
    """Add some to the honest ones, and remove them afterwards."""
    settings = tested.settings
    with ExitStack() as sessions:
        session = open_session(settings.zenoh, settings.robot, StopFlag(), wait_s=PATIENCE_S)
        opened = sessions.enter_context(session)
        yield [UntrueWorker(opened, name) for name in names]
