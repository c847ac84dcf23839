"""The rim of the soak: hears everything of one robot, asks for its pose, and stamps what comes."""

import logging
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from typing import TypeVar

import zenoh
from zenoh import handlers

from protocol import keys
from protocol.answers import PoseAnswer, Status
from protocol.codec import decode
from protocol.errors import MalformedMessageError, UnreachableError
from soak_test.pose_checks import Question
from soak_test.robot import TRUTH_KEY
from zenoh_link.deaf_link import DEAF, DeafLink
from zenoh_link.inbox import Inbox
from zenoh_link.wire import AS_THEY_COME, Event, watch_link

ASK_TIMEOUT_S = 1.0
_CONNECT_WITHIN_S, _AGAIN_WITHIN_S = 30.0, 0.5
_WAITING = 20_000

M = TypeVar("M")
OpenSession = Callable[[float], AbstractContextManager[zenoh.Session]]
"""Connects within so many seconds; raises `UnreachableError`."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Heard:
    """A message, as it came."""

    at_ns: int
    key: str
    payload: bytes


@dataclass(frozen=True)
class TokenHeard:
    """A liveliness token came or went."""

    at_ns: int
    key: str
    alive: bool


@dataclass(frozen=True)
class StatusHeard:
    """An answer about the coordinator's counters."""

    at_ns: int
    status: Status


Arrived = Heard | TokenHeard | StatusHeard | Question


class Listener:
    """Everything that one robot's processes say, in the order of arrival; nothing waits.

    Hears until it is closed, through another session once a link has come back deaf.

    Args:
        open_session: of the robot.

    Raises:
        UnreachableError: there is no router.
    """

    def __init__(self, open_session: OpenSession) -> None:
        self._open_session = open_session
        self._arrived: deque[Arrived] = deque(maxlen=_WAITING)
        self._listen(_CONNECT_WITHIN_S)

    def close(self) -> None:
        """Hear nothing any more."""
        self._opened.close()

    def _listen(self, within_s: float) -> None:
        """Hear through a session of now on; the one of before is its caller's to close."""
        with ExitStack() as opening:
            session = opening.enter_context(self._open_session(within_s))
            self._deaf, self._link = DeafLink(), Inbox[Event]({})
            watch_link(session, self._link)
            for key in (keys.EVENTS, keys.BELIEF, keys.SCAN, keys.ALL_REPORTS, TRUTH_KEY):
                session.declare_subscriber(key, self._on_sample)
            for key in (keys.LASER_READING, keys.ODOMETRY_READING):
                session.declare_subscriber(key, self._on_sample)
            for key in (keys.COORDINATOR_ALIVE, keys.ALL_WORKERS_ALIVE):
                session.liveliness().declare_subscriber(key, self._on_token, history=True)
            self._session, self._opened = session, opening.pop_all()

    def arrived(self) -> list[Arrived]:
        """What has come since the last call."""
        arrived = [self._arrived.popleft() for _ in range(len(self._arrived))]
        self._look_after_link(arrived, time.monotonic_ns())
        return arrived

    def _look_after_link(self, arrived: list[Arrived], now_ns: int) -> None:
        for one in filter(_came_through, arrived):
            self._deaf.on_event(one, now_ns)
        while (event := self._link.get(0.0)) is not None:
            self._deaf.on_event(event, now_ns)
        if self._deaf.is_suspect(now_ns):
            deaf = self._opened
            try:
                self._listen(_AGAIN_WITHIN_S)
            except UnreachableError:  # nobody is to be heard
                return
            _log.warning(DEAF)
            deaf.close()

    def ask_pose(self) -> None:
        """Ask for the pose without waiting; a `Question` arrives later, answered or not."""
        asked_ns = time.time_ns()
        answers: list[PoseAnswer] = []

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is None or answers:
                return
            answer = _decoded(reply.ok.payload.to_bytes(), PoseAnswer)
            if answer is not None:
                answers.append(answer)
                self._arrived.append(Question(asked_ns, time.time_ns(), answer))

        def on_done() -> None:
            if not answers:
                self._arrived.append(Question(asked_ns, time.time_ns(), None))

        self._session.get(
            keys.POSE,
            handlers.Callback(on_reply, on_done),
            consolidation=AS_THEY_COME,
            timeout=ASK_TIMEOUT_S,
        )

    def ask_status(self) -> None:
        """Ask for the coordinator's counters without waiting."""

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is None:
                return
            status = _decoded(reply.ok.payload.to_bytes(), Status)
            if status is not None:
                self._arrived.append(StatusHeard(time.time_ns(), status))

        self._session.get(
            keys.STATUS,
            handlers.Callback(on_reply, lambda: None),
            consolidation=AS_THEY_COME,
            timeout=ASK_TIMEOUT_S,
        )

    def say(self, key: str, payload: bytes) -> None:
        """Publish whatever it is."""
        self._session.put(key, payload)

    def ask_anything(self, selector: str, payload: bytes) -> None:
        """Ask whatever it is; nobody is interested in the answer."""

        def on_reply(_reply: zenoh.Reply) -> None:
            pass

        self._session.get(
            selector,
            handlers.Callback(on_reply, lambda: None),
            payload=payload,
            timeout=ASK_TIMEOUT_S,
        )

    def _on_sample(self, sample: zenoh.Sample) -> None:
        heard = Heard(time.time_ns(), str(sample.key_expr), sample.payload.to_bytes())
        self._arrived.append(heard)

    def _on_token(self, sample: zenoh.Sample) -> None:
        alive = sample.kind == zenoh.SampleKind.PUT
        self._arrived.append(TokenHeard(time.time_ns(), str(sample.key_expr), alive))


def _came_through(arrived: Arrived) -> bool:
    """Whether it shows that something comes through the link."""
    match arrived:
        case Question(answer=None) | TokenHeard(alive=False):
            return False
        case _:
            return True


def _decoded(payload: bytes, kind: type[M]) -> M | None:
    try:
        return decode(payload, kind)
    except MalformedMessageError:
        return None  # counts as no answer
