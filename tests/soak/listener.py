"""Subscribes to all messages of one robot, queries its pose, and stamps messages on arrival."""

import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass

import zenoh
from zenoh import handlers

from protocol import keys
from protocol.answers import PoseAnswer
from protocol.codec import decode
from protocol.errors import MalformedMessageError, UnreachableError
from robot_simulator.driver import TRUTH_KEY
from tests.soak.pose_promises import Question
from zenoh_link.inbox import Inbox
from zenoh_link.stale_session import STALE, StaleSessionDetector
from zenoh_link.wire import AS_THEY_COME, Event, watch_link

ASK_TIMEOUT_S = 1.0
_SUBSCRIBED = (
    keys.EVENTS, keys.BELIEF, keys.SCAN, keys.ALL_REPORTS, TRUTH_KEY,
    keys.LASER_READING, keys.ODOMETRY_READING,
)  # fmt: skip
_CONNECT_WITHIN_S, _AGAIN_WITHIN_S = 30.0, 0.5
_WAITING = 20_000

OpenSession = Callable[[float], AbstractContextManager[zenoh.Session]]
"""Connects within this many seconds; raises `UnreachableError`."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Received:
    """A message with its time of arrival."""

    at_ns: int
    key: str
    payload: bytes


Arrived = Received | Question


class Listener:
    """Collects messages of one robot in the order of arrival, without blocking.

    A stale session is replaced by a new one.

    Args:
        open_session: opens a session of the robot.

    Raises:
        UnreachableError: there is no router.
    """

    def __init__(self, open_session: OpenSession) -> None:
        self._open_session = open_session
        self._arrived: deque[Arrived] = deque(maxlen=_WAITING)
        self._subscribe(_CONNECT_WITHIN_S)

    def close(self) -> None:
        self._opened.close()

    def _subscribe(self, within_s: float) -> None:
        """Subscribe through a new session; the caller closes the previous one."""
        with ExitStack() as opening:
            session = opening.enter_context(self._open_session(within_s))
            self._stale, self._link = StaleSessionDetector(), Inbox[Event]({})
            watch_link(session, self._link)
            for key in _SUBSCRIBED:
                session.declare_subscriber(key, self._on_sample)
            self._session, self._opened = session, opening.pop_all()

    def arrived(self) -> list[Arrived]:
        """Return the messages that arrived since the last call."""
        arrived = [self._arrived.popleft() for _ in range(len(self._arrived))]
        self._replace_stale_session(arrived, time.monotonic_ns())
        return arrived

    def _replace_stale_session(self, arrived: list[Arrived], now_ns: int) -> None:
        for one in arrived:
            if not (isinstance(one, Question) and one.answer is None):
                self._stale.on_event(one, now_ns)
        while (event := self._link.get(0.0)) is not None:
            self._stale.on_event(event, now_ns)
        if self._stale.is_suspect(now_ns):
            stale = self._opened
            try:
                self._subscribe(_AGAIN_WITHIN_S)
            except UnreachableError:  # no router now: the next call retries
                return
            _log.warning(STALE)
            stale.close()

    def ask_pose(self) -> None:
        """Query the pose without blocking; a `Question` arrives later, answered or not."""
        asked_ns = time.time_ns()
        answers: list[PoseAnswer] = []

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is None or answers:
                return
            try:
                answers.append(decode(reply.ok.payload.to_bytes(), PoseAnswer))
            except MalformedMessageError:  # counts as no answer
                return
            self._arrived.append(Question(asked_ns, time.time_ns(), answers[0]))

        def on_done() -> None:
            if not answers:
                self._arrived.append(Question(asked_ns, time.time_ns(), None))

        self._session.get(
            keys.POSE,
            handlers.Callback(on_reply, on_done),
            consolidation=AS_THEY_COME,
            timeout=ASK_TIMEOUT_S,
        )

    def publish(self, key: str, payload: bytes) -> None:
        self._session.put(key, payload)

    def query(self, selector: str, payload: bytes) -> None:
        """Query with any bytes; the reply is ignored."""

        def on_reply(_reply: zenoh.Reply) -> None:
            pass

        ignored = handlers.Callback(on_reply, lambda: None)
        self._session.get(selector, ignored, payload=payload, timeout=ASK_TIMEOUT_S)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        received = Received(time.time_ns(), str(sample.key_expr), sample.payload.to_bytes())
        self._arrived.append(received)
