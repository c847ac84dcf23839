"""Waits while the robot has a coordinator, and says when it is dead."""

import logging
import time

import zenoh

from coordinator.membership.membership import SETTLE_NS
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.work import Checkpoint
from zenoh_link.inbox import Inbox
from zenoh_link.wire import Events, Link, Received, Token, subscribe, watch, watch_link

TICK_S = 0.05

_log = logging.getLogger(__name__)


class FailureDetector:
    """Told of signs of life; says when there are none any more.

    A token that vanishes while the own link stands is a death that the router has seen. Without
    that, silence must last: a link that was lost, here or there, comes back first.
    """

    def __init__(self, take_over_after_s: float, now_ns: int) -> None:
        self._silence_ns = int(take_over_after_s * 1e9)
        self._linked = True
        self._last_sign_ns = now_ns
        self._died_ns: int | None = None

    def sign_of_life(self, now_ns: int) -> None:
        """The coordinator speaks, or its token is there."""
        self._last_sign_ns, self._died_ns = now_ns, None

    def token_vanished(self, now_ns: int) -> None:
        """The coordinator's token is gone, or this process's own link."""
        self._died_ns = now_ns

    def link(self, up: bool, now_ns: int) -> None:
        """The own link came up or was lost: nothing that was heard about it counts."""
        self._linked = up
        self._last_sign_ns, self._died_ns = now_ns, None

    def is_over(self, now_ns: int) -> bool:
        """Whether to take over."""
        if not self._linked:
            return False
        if self._died_ns is not None and now_ns - self._died_ns >= SETTLE_NS:
            return True
        return now_ns - self._last_sign_ns >= self._silence_ns


class StandbyLoop:
    """The rim of the failure detector."""

    def __init__(self, session: zenoh.Session, take_over_after_s: float) -> None:
        self._session = session
        self._inbox: Events = Inbox({"checkpoint": 4})
        self._detector = FailureDetector(take_over_after_s, time.monotonic_ns())
        self.newest: Checkpoint | None = None
        """The newest checkpoint heard."""

    def run(self, stop: StopFlag) -> bool:
        """Wait; True when it is time to take over, False when told to stop."""
        subscribe(self._session, keys.CHECKPOINT, self._inbox, "checkpoint")
        watch_link(self._session, self._inbox)
        watch(self._session, keys.COORDINATOR_ALIVE, self._inbox)
        _log.info("standing by: the robot has a coordinator")
        while not stop.is_set():
            event = self._inbox.get(TICK_S)
            now_ns = time.monotonic_ns()
            match event:
                case Received(payload=payload):
                    self._on_checkpoint(payload, now_ns)
                case Token(alive=True):
                    self._detector.sign_of_life(now_ns)
                case Token(alive=False):
                    self._detector.token_vanished(now_ns)
                case Link(up=up):
                    self._detector.link(up, now_ns)
            if event is None and self._detector.is_over(now_ns):
                return True
        return False

    def _on_checkpoint(self, payload: bytes, now_ns: int) -> None:
        try:
            checkpoint = decode(payload, Checkpoint)
        except MalformedMessageError as error:
            _log.debug("malformed checkpoint: %s", error)
            return
        if self.newest is None or checkpoint.rank >= self.newest.rank:
            self.newest = checkpoint
            self._detector.sign_of_life(now_ns)
