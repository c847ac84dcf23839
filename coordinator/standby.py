"""Waits while the robot has a coordinator, and says when it is dead."""

import logging
import time
from collections.abc import Callable

import zenoh

from coordinator.failover.failure_detector import FailureDetector
from coordinator.newest_checkpoint import NewestCheckpoint
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.codec import decode
from protocol.errors import MalformedMessageError
from protocol.terms import check_term
from protocol.work import Checkpoint
from zenoh_link.inbox import Inbox
from zenoh_link.stale_session import STALE, StaleSessionDetector
from zenoh_link.wire import Events, Link, Received, Token, subscribe, watch, watch_link

TICK_S = 0.05

_log = logging.getLogger(__name__)


class StandbyLoop:
    """Listens for signs of life; the newest checkpoint heard is where it would carry on."""

    def __init__(
        self,
        session: zenoh.Session,
        take_over_after_s: float,
        is_another_there: Callable[[], bool],
        newest: NewestCheckpoint,
    ) -> None:
        """Begin to listen.

        Args:
            session: of this process.
            take_over_after_s: see `FailureDetector`.
            is_another_there: whether somebody who hears well sees a coordinator.
            newest: of the checkpoints heard before; those that come are added.
        """
        self._session = session
        self._is_another_there, self._stale = is_another_there, StaleSessionDetector()
        self._inbox: Events = Inbox({"checkpoint": 4})
        self._detector = FailureDetector(take_over_after_s, time.monotonic_ns())
        self._newest = newest

    def run(self, stop: StopFlag) -> bool:
        """Wait; True when it is time to take over, False when told to stop or deaf."""
        subscribe(self._session, keys.CHECKPOINT, self._inbox, "checkpoint")
        watch_link(self._session, self._inbox)
        watch(self._session, keys.COORDINATOR_ALIVE, self._inbox)
        _log.info("standing by: the robot has a coordinator")
        while not stop.is_set():
            event = self._inbox.get(TICK_S)
            now_ns = time.monotonic_ns()
            self._stale.on_event(event, now_ns)
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
                is_stale = self._stale.is_armed and self._is_another_there()
                if is_stale:
                    _log.warning(STALE)
                return not is_stale
        return False

    def _on_checkpoint(self, payload: bytes, now_ns: int) -> None:
        try:
            checkpoint = decode(payload, Checkpoint)
            check_term(checkpoint, time.time_ns())
        except MalformedMessageError as error:
            _log.debug("malformed checkpoint: %s", error)
            return
        if self._newest.hear(checkpoint, now_ns):
            self._detector.sign_of_life(now_ns)
