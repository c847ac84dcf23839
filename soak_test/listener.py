"""The rim of the soak: hears everything of one robot, asks for its pose, and stamps what comes."""

import time
from collections import deque
from dataclasses import dataclass
from typing import TypeVar

import zenoh
from zenoh import handlers

from protocol import keys
from protocol.answers import PoseAnswer, Status
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from soak_test.pose_checks import Question
from soak_test.robot import TRUTH_KEY
from zenoh_link.wire import AS_THEY_COME

ASK_TIMEOUT_S = 1.0
_WAITING = 20_000

M = TypeVar("M")


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
    """Everything that one robot's processes say, in the order of arrival; nothing waits."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._arrived: deque[Arrived] = deque(maxlen=_WAITING)
        for key in (keys.EVENTS, keys.BELIEF, keys.SCAN, keys.ALL_REPORTS, TRUTH_KEY):
            session.declare_subscriber(key, self._on_sample)
        for key in (keys.LASER_READING, keys.ODOMETRY_READING):
            session.declare_subscriber(key, self._on_sample)
        for key in (keys.COORDINATOR_ALIVE, keys.ALL_WORKERS_ALIVE):
            session.liveliness().declare_subscriber(key, self._on_token, history=True)

    def arrived(self) -> list[Arrived]:
        """What has come since the last call."""
        return [self._arrived.popleft() for _ in range(len(self._arrived))]

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


def _decoded(payload: bytes, kind: type[M]) -> M | None:
    try:
        return decode(payload, kind)
    except MalformedMessageError:
        return None  # counts as no answer
