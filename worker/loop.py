"""The rim of one worker: Zenoh in, Zenoh out; what happens between is `worker.worker`."""

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import zenoh

from process_runtime.latency_trace import mark
from process_runtime.logs import CauseCounter
from process_runtime.memory import HeapTrimmer
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.codec import decode
from protocol.errors import ClusterMclError, MalformedMessageError
from protocol.keys import WorkerKey, WorkerTopic
from protocol.steps import MapMessage, Scan, ScanHistory
from protocol.terms import check_term
from protocol.work import Checkpoint, TakeOver, WorkOrder
from worker.events import (
    BrokenOrderAsked,
    CheckpointHeard,
    Event,
    HistoryArrived,
    HistoryFailed,
    MapArrived,
    MapFailed,
    OrderAsked,
    ScanArrived,
    StateAsked,
    TimeToSearch,
)
from worker.instructions import FetchMap, FetchScans
from worker.outgoing import ANSWERS, Built, Fetched, Outgoing, WorkerInbox
from worker.search_pause import SearchPause
from worker.worker import Worker
from zenoh_link.health import HealthReporter
from zenoh_link.inbox import Inbox
from zenoh_link.stale_session import STALE, StaleSessionDetector
from zenoh_link.wire import (
    Asked,
    Publisher,
    Received,
    Unread,
    serve,
    subscribe,
    watch_link,
)

KEPT_SCANS = 64
KEPT_ANSWERS = 16
POLL_S = 0.25
"""Between two looks at whether to stop, where nothing comes."""
SOON_S = 0.01
PAUSE_S = 0.004
"""Between two looks at whether a step is decided, while searches pause for it."""
KEPT_CHECKPOINTS = 4
"""Between two looks: some of each of two coordinators of which one takes over."""
SCANS_TO_A_LOOK = 2
"""After the second one's report, or before anything else: waking up for them costs as much as
reading them, and who asks for checkpoints gets all that have come."""

_log = logging.getLogger(__name__)

T = TypeVar("T", WorkOrder, TakeOver, Checkpoint)


class WorkerLoop:
    """One worker's life between its first connection and its stop."""

    def __init__(
        self,
        name: str,
        session: zenoh.Session,
        cache_folder: Path,
        incarnation: int,
        is_coordinator_there: Callable[[], bool],
    ) -> None:
        self._is_coordinator_there, self._stale = is_coordinator_there, StaleSessionDetector()
        self._name, self._session = name, session
        self._worker, self._pause = Worker(name, incarnation), SearchPause()
        self._inbox: WorkerInbox = Inbox({"scan": KEPT_SCANS, ANSWERS: KEPT_ANSWERS})
        self._causes = CauseCounter()
        self._health = HealthReporter(name, "worker", self._causes, self._inbox)
        self._heap = HeapTrimmer()
        self._health_key = Publisher(session, keys.worker_health(name))
        self._outgoing = Outgoing(
            name, session, self._inbox, self._health, self._causes, cache_folder
        )

    def run(self, stop: StopFlag) -> None:
        """Serve until told to stop, or until deaf: who is there gives its clusters to others."""
        subscribe(self._session, keys.SCAN, self._inbox, "scan")
        watch_link(self._session, self._inbox)
        checkpoints = Unread(
            self._session, keys.CHECKPOINT, self._inbox, "checkpoint", KEPT_CHECKPOINTS
        )
        serve(self._session, keys.worker_order(self._name), self._inbox)
        serve(self._session, keys.worker_state(self._name), self._inbox)
        with self._session.liveliness().declare_token(keys.worker_alive(self._name)):
            unread_scans = 0
            while not (stop.is_set() or self._is_session_stale()):
                event = self._inbox.get(self._wait_s())
                self._stale.on_event(event, time.monotonic_ns())
                if isinstance(event, Received):
                    self._on_scan(event, time.monotonic_ns())
                    unread_scans += 1
                    if unread_scans < SCANS_TO_A_LOOK:
                        continue
                unread_scans = 0
                for payload in checkpoints.drain():
                    self._stale.on_event(payload, time.monotonic_ns())
                    self._on_checkpoint(payload)
                match event:
                    case Asked():
                        self._on_query(event)
                    case Fetched():
                        self._tell(_what_came(event))
                    case Built():
                        self._tell(_what_was_built(event))
                    case MapFailed() | HistoryFailed():
                        self._tell(event)
                if self._worker.searches and not self._pause.left_ns(time.monotonic_ns()):
                    self._tell(TimeToSearch())
                if event is None:
                    self._heap.trim_if_due(time.monotonic())
                self._outgoing.ask_again()
                self._health.publish_if_due(self._health_key)

    def _is_session_stale(self) -> bool:
        is_stale = self._stale.is_suspect(time.monotonic_ns()) and self._is_coordinator_there()
        if is_stale:
            _log.warning("%s: %s", self._name, STALE)
        return is_stale

    def _wait_s(self) -> float:
        if self._worker.searches:
            return min(self._pause.left_ns(time.monotonic_ns()) / 1e9, PAUSE_S)
        return SOON_S if self._outgoing.asks_again else POLL_S

    def _tell(self, event: Event) -> None:
        self._outgoing.carry_out(self._worker.handle(event))

    def _warn(self, error: MalformedMessageError) -> None:
        self._causes.warn(_log, error.cause, error, time.monotonic())

    def _on_scan(self, received: Received, taken_ns: int) -> None:
        try:
            scan = decode(received.payload, Scan)
        except MalformedMessageError as error:
            self._warn(error)
            return
        mark("arrived", scan, received.at_ns)
        mark("taken", scan, taken_ns)
        mark("decoded", scan)
        self._health.happened("scans")
        dropped = self._inbox.dropped().get("scan", 0)
        self._pause.scanned(scan.step, taken_ns)
        instructions = self._worker.handle(ScanArrived(scan, dropped))
        mark("computed", scan)
        self._outgoing.carry_out(instructions)

    def _on_checkpoint(self, payload: bytes) -> None:
        try:
            checkpoint = _with_term(payload, Checkpoint)
        except MalformedMessageError as error:
            self._warn(error)
            return
        self._pause.believed(checkpoint.step, founded=checkpoint.founded)
        self._tell(CheckpointHeard(checkpoint))

    def _on_query(self, asked: Asked) -> None:
        match keys.parsed(asked.key):
            case WorkerKey(topic=WorkerTopic.ORDER):
                self._on_order_asked(asked)
            case WorkerKey(topic=WorkerTopic.STATE):
                self._on_state_asked(asked)

    def _on_order_asked(self, asked: Asked) -> None:
        question = self._outgoing.number(asked)
        try:
            event: Event = OrderAsked(question, _with_term(asked.payload, WorkOrder))
        except MalformedMessageError as error:
            event = BrokenOrderAsked(question, error)
        self._tell(event)

    def _on_state_asked(self, asked: Asked) -> None:
        try:
            take_over = _with_term(asked.payload, TakeOver) if asked.payload else None
        except MalformedMessageError as error:
            self._warn(error)
            asked.refuse(str(error))
            return
        self._tell(StateAsked(self._outgoing.number(asked), take_over))
        self._heap.on_large_message(time.monotonic())


def _with_term(payload: bytes, kind: type[T]) -> T:
    """A message of a coordinator's, whose term can be."""
    message = decode(payload, kind)
    check_term(message, time.time_ns())
    return message


def _what_came(fetched: Fetched) -> Event:
    match fetched.asked:
        case FetchMap():
            try:
                return MapArrived(decode(fetched.payload, MapMessage))
            except MalformedMessageError as error:
                return MapFailed(error)
        case FetchScans(missing):
            try:
                return HistoryArrived(missing, decode(fetched.payload, ScanHistory).scans)
            except MalformedMessageError as error:
                return HistoryFailed(missing, str(error))


def _what_was_built(built: Built) -> Event:
    try:
        return built.outcome.result()
    except (ClusterMclError, ValueError) as error:
        return MapFailed(error)
