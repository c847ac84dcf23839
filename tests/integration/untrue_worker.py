"""A worker that answers every order and question, and computes nothing."""

import zenoh

from clustermcl.protocol import keys
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.work import OrderAnswer, TakeOver, WorkerState, WorkOrder


class UntrueWorker:
    """Answers in Zenoh's threads for as long as its session lasts."""

    def __init__(self, session: zenoh.Session, name: str, lift: int = 0) -> None:
        self._name, self._lift = name, lift
        self.asked: list[TakeOver] = []
        self.ordered: list[WorkOrder] = []
        session.declare_queryable(keys.worker_order(name), self._on_order)
        session.declare_queryable(keys.worker_state(name), self._on_state)
        self._token = session.liveliness().declare_token(keys.worker_alive(name))

    def _on_order(self, query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            order = decode(query.payload.to_bytes(), WorkOrder)
            epochs = dict(order.keep) | {one.job_id: one.epoch for one in order.begin}
            jobs = tuple((job_id, epoch, -1) for job_id, epoch in epochs.items())
            term = order.term + self._lift
            answer = OrderAnswer(sender=self._name, order=order.order, term=term, jobs=jobs)
            query.reply(query.key_expr, encode(answer))
            self.ordered.append(order)

    def _on_state(self, query: zenoh.Query) -> None:
        with query:
            assert query.payload is not None
            asked = decode(query.payload.to_bytes(), TakeOver)
            term = asked.term + self._lift
            reported = WorkerState(sender=self._name, term=term, holds=())
            query.reply(query.key_expr, encode(reported))
            self.asked.append(asked)
