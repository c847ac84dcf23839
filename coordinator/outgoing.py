"""What the coordinator has decided, carried out over Zenoh."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable

import zenoh

from coordinator.instructions import (
    AnswerCommand,
    AskState,
    FetchMap,
    FetchScans,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
    PublishEvents,
    SendOrder,
)
from protocol import keys
from protocol.job_events import event_text
from protocol.message import Message
from zenoh_link.wire import EventSink, Publisher, ask_later

ASK_AGAIN_WITHIN_S = 0.5
"""Just after a link came up, a query for lost scans finds nobody; it is repeated so long."""
ORDER_TIMEOUT_S = 35.0
"""A worker that fetches a large map before it answers takes long; orders are repeated sooner."""

_log = logging.getLogger(__name__)


class Outgoing:
    """Publishes and asks; answers come through the inbox."""

    def __init__(self, session: zenoh.Session, inbox: EventSink) -> None:
        self._session, self._inbox = session, inbox
        self._events = Publisher(session, keys.EVENTS)
        self._belief = Publisher(session, keys.BELIEF)
        self._pose = Publisher(session, keys.POSE)
        self._checkpoints = Publisher(session, keys.CHECKPOINT)
        self._unanswered: deque[tuple[FetchScans, float]] = deque()

    def carry_out(self, instructions: Iterable[Instruction]) -> None:
        """Do what was decided, in its order; ask again what nobody answered."""
        for _ in range(len(self._unanswered)):
            self._fetch(*self._unanswered.popleft())
        for instruction in instructions:
            match instruction:
                case SendOrder(worker, order):
                    self._ask(keys.worker_order(worker), order)
                case AskState(worker, question):
                    self._ask(keys.worker_state(worker), question)
                case FetchScans():
                    self._fetch(instruction, time.monotonic() + ASK_AGAIN_WITHIN_S)
                case FetchMap():
                    self._ask(keys.MAP)
                case PublishCheckpoint(checkpoint):
                    self._checkpoints.put(checkpoint)
                case PublishEvents(events):
                    self._events.put(events)
                    for numbered in events.events:
                        _log.info("step %d: %s", numbered.step, event_text(numbered.event))
                case PublishBelief(belief, pose):
                    self._belief.put(belief)
                    self._pose.put(pose)
                case AnswerCommand():
                    pass  # by who holds the question

    def _fetch(self, fetch: FetchScans, until_s: float) -> None:
        def on_failure(refused: str) -> None:
            if not refused and time.monotonic() < until_s:
                self._unanswered.append((fetch, until_s))

        self._ask(keys.scan_history(fetch.first, fetch.last), on_failure=on_failure)

    def _ask(
        self,
        selector: str,
        message: Message | None = None,
        *,
        on_failure: Callable[[str], object] = lambda _: None,
    ) -> None:
        """Ask without waiting."""
        ask_later(
            self._session,
            selector,
            self._inbox.put_own,
            on_failure,
            timeout_s=ORDER_TIMEOUT_S,
            message=message,
        )
