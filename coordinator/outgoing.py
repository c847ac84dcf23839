"""What the coordinator has decided, carried out over Zenoh."""

from collections.abc import Iterable

import zenoh
from zenoh import handlers

from coordinator.instructions import (
    AskState,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
    SendOrder,
)
from process_runtime.wire import Events, Publisher, Received
from protocol import keys
from protocol.codec import encode
from protocol.message import Message

ORDER_TIMEOUT_S = 35.0
"""A worker that fetches a large map before it answers takes long; orders are repeated sooner."""


class Outgoing:
    """Publishes and asks; answers come through the inbox."""

    def __init__(self, session: zenoh.Session, inbox: Events) -> None:
        self._session, self._inbox = session, inbox
        self._belief = Publisher(session, keys.BELIEF)
        self._pose = Publisher(session, keys.POSE)
        self._checkpoints = Publisher(session, keys.CHECKPOINT)

    def carry_out(self, instructions: Iterable[Instruction]) -> None:
        """Do what was decided, in its order."""
        for instruction in instructions:
            match instruction:
                case SendOrder(worker, order):
                    self._ask(keys.worker_order(worker), order)
                case AskState(worker, question):
                    self._ask(keys.worker_state(worker), question)
                case FetchScans(first, last):
                    self._ask(keys.scan_history(first, last))
                case PublishCheckpoint(checkpoint):
                    self._checkpoints.put(checkpoint)
                case PublishBelief(belief, pose):
                    self._belief.put(belief)
                    self._pose.put(pose)

    def _ask(self, selector: str, message: Message | None = None) -> None:
        """Ask without waiting."""

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                key = str(reply.ok.key_expr)
                self._inbox.put(Received(key, reply.ok.payload.to_bytes()))

        self._session.get(
            selector,
            handlers.Callback(on_reply, lambda: None),
            payload=encode(message) if message is not None else None,
            timeout=ORDER_TIMEOUT_S,
        )
