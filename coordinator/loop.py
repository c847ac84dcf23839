"""The rim of the coordinator: Zenoh in, Zenoh out; what happens between is `Coordinator`."""

import logging
import threading
import time
from collections.abc import Callable, Iterable
from typing import TypeAlias

import msgspec
import zenoh

from coordinator import events
from coordinator.coordinator import Coordinator
from coordinator.events import (
    CheckpointHeard,
    CommandArrived,
    HistoryArrived,
    LinkBack,
    LinkLost,
    MapArrived,
    OdometryArrived,
    OrderAnswered,
    ReportArrived,
    ScanArrived,
    TimePassed,
    WorkerToldState,
)
from coordinator.failover.self_fencing import SelfFencing
from coordinator.failover.state_recovery import told_by
from coordinator.free_ground import FreeGround
from coordinator.instructions import (
    AnswerCommand,
    Instruction,
    PublishBelief,
    PublishCheckpoint,
)
from coordinator.membership.health_board import MAX_PROCESSES, HealthBoard
from coordinator.membership.membership import Change, Membership
from coordinator.newest_checkpoint import NewestCheckpoint
from coordinator.outgoing import Outgoing
from coordinator.recorder.flight_recorder import FlightRecorder
from coordinator.report_sizes import check_places, has_too_large_snapshot
from coordinator.state_file import StateKeeper
from coordinator.step_collector import without_snapshot
from grid_maps.map_message import from_message
from process_runtime.latency_trace import mark
from process_runtime.logs import CauseCounter
from process_runtime.memory import HeapTrimmer
from process_runtime.stop import StopFlag
from protocol import keys
from protocol.answers import Relocalize, SetPose, Status
from protocol.codec import decode
from protocol.errors import MalformedMessageError, MapMismatchError, printable
from protocol.health import Health
from protocol.keys import WorkerKey, WorkerTopic
from protocol.steps import MapMessage, OdometryReading, Scan, ScanHistory
from protocol.terms import check_term
from protocol.work import Checkpoint, OrderAnswer, Report
from zenoh_link.health import HealthReporter
from zenoh_link.inbox import Inbox
from zenoh_link.stale_session import STALE, StaleSessionDetector
from zenoh_link.wire import (
    Asked,
    Event,
    Link,
    Received,
    Token,
    alive,
    serve,
    subscribe,
    watch,
    watch_link,
)

ROSTER_TIMEOUT_S = 1.0
TICK_S = 0.05
TICK_NS = int(TICK_S * 1e9)

_log = logging.getLogger(__name__)

_InboxEvent: TypeAlias = Event | FreeGround | MalformedMessageError
"""The map's thread sends the last two."""


class CoordinatorLoop:
    """One coordinator's life between its connection and its stop."""

    def __init__(
        self,
        coordinator: Coordinator,
        session: zenoh.Session,
        keeper: StateKeeper,
        recorder: FlightRecorder,
        heard: NewestCheckpoint,
        causes: CauseCounter,
        is_anybody_there: Callable[[], bool],
    ) -> None:
        self._is_anybody_there, self._stale = is_anybody_there, StaleSessionDetector()
        self._coordinator, self._session, self._keeper = coordinator, session, keeper
        self._recorder, self._heard = recorder, heard
        self._map_reader: threading.Thread | None = None
        self._inbox: Inbox[_InboxEvent] = Inbox(
            {"scan": 256, "odometry": 1, "report": 4096, "health": 1024, "checkpoint": 4}
        )
        self._causes, self._another_map = causes, CauseCounter()
        self._health = HealthReporter("coordinator", "coordinator", self._causes, self._inbox)
        self._board = HealthBoard()
        self._membership = Membership()
        self._fencing = SelfFencing(time.monotonic_ns())
        self._outgoing = Outgoing(session, self._inbox)
        self._heap, self._ticked_ns = HeapTrimmer(), 0

    def run(self, stop: StopFlag) -> None:
        """Coordinate until told to stop, until another coordinator acts, or until deaf."""
        subscribe(self._session, keys.SCAN, self._inbox, "scan")
        subscribe(self._session, keys.ODOMETRY, self._inbox, "odometry")
        subscribe(self._session, keys.ALL_REPORTS, self._inbox, "report")
        subscribe(self._session, keys.CHECKPOINT, self._inbox, "checkpoint", own=False)
        for key in (keys.BRIDGE_HEALTH, keys.ALL_WORKERS_HEALTH):
            subscribe(self._session, key, self._inbox, "health")
        watch_link(self._session, self._inbox)
        for key in alive(self._session, keys.ALL_WORKERS_ALIVE, ROSTER_TIMEOUT_S):
            self._inbox.put(Token(key, alive=True))
        watch(self._session, keys.ALL_WORKERS_ALIVE, self._inbox)
        while not (stop.is_set() or self._coordinator.begun):
            self._turn()
        for key in (
            *(keys.POSE, keys.HYPOTHESES, keys.EVENTS, keys.STATUS),
            *(keys.SET_POSE, keys.RELOCALIZE),
        ):
            serve(self._session, key, self._inbox)
        token = self._session.liveliness().declare_token(keys.COORDINATOR_ALIVE)
        with self._keeper.running(), token:
            _log.info("coordinator ready")
            while not (stop.is_set() or self._coordinator.outranked_by or self._is_session_stale()):
                self._turn()

    def _turn(self) -> None:
        """Take what arrived first and do what comes of it."""
        event = self._inbox.get(TICK_S)
        now_ns = time.monotonic_ns()
        self._stale.on_event(event, now_ns)
        self._fencing.turn(now_ns)
        self._carry_out(self._handle(event, now_ns))
        if now_ns - self._ticked_ns >= TICK_NS:  # queries or odometry may leave no idle moment
            self._carry_out(self._handle(None, now_ns))
        self._carry_out(self._change(self._membership.due(now_ns), now_ns))
        if event is None:
            self._heap.trim_if_due(now_ns / 1e9)

    def _is_session_stale(self) -> bool:
        is_stale = self._stale.is_suspect(time.monotonic_ns()) and self._is_anybody_there()
        if is_stale:
            _log.warning(STALE)
        return is_stale

    def _handle(self, event: _InboxEvent | None, now_ns: int) -> list[Instruction]:
        try:
            match event:
                case Received():
                    return self._on_message(event, now_ns)
                case Asked():
                    return self._on_query(event, now_ns)
                case Token():
                    name = keys.worker_name(event.key)
                    return self._change(self._membership.token(name, event.alive, now_ns), now_ns)
                case Link():
                    return self._on_link(event, now_ns)
                case FreeGround():
                    return self._recorder.handle(MapArrived(event), now_ns)
                case MalformedMessageError():
                    raise event
        except MalformedMessageError as error:
            self._causes.warn(_log, error.cause, error, time.monotonic())
        self._ticked_ns = now_ns
        return self._recorder.handle(TimePassed(), now_ns)

    def _on_message(self, message: Received, now_ns: int) -> list[Instruction]:
        match keys.parsed(message.key):
            case keys.BRIDGE_HEALTH | WorkerKey(topic=WorkerTopic.HEALTH):
                self._on_health(message.key, decode(message.payload, Health), now_ns)
                return []
            case key:
                return self._recorder.handle(self._event_of(key, message, now_ns), now_ns)

    def _event_of(  # noqa: PLR0911 - one for each key
        self, key: str | WorkerKey, message: Received, now_ns: int
    ) -> events.Event:
        """What a message means."""
        match key:
            case keys.SCAN:
                scan = decode(message.payload, Scan)
                self._health.happened("scans")
                self._warn_of_another_map(scan)
                return ScanArrived(scan)
            case keys.ODOMETRY:
                self._health.happened("odometry")
                return OdometryArrived(decode(message.payload, OdometryReading))
            case keys.SCAN_HISTORY:
                return HistoryArrived(decode(message.payload, ScanHistory).scans)
            case keys.MAP:
                self._heap.on_large_message(now_ns / 1e9)
                self._read_map(message.payload)
                return TimePassed()
            case keys.CHECKPOINT:
                checkpoint = decode(message.payload, Checkpoint)
                check_term(checkpoint, time.time_ns())
                self._heard.hear(checkpoint, now_ns)
                return CheckpointHeard(checkpoint)
            case WorkerKey(worker, WorkerTopic.STATE):
                self._heap.on_large_message(now_ns / 1e9)
                return WorkerToldState(worker, told_by(message.payload, time.time_ns()))
            case WorkerKey(worker, WorkerTopic.ORDER):
                answer = decode(message.payload, OrderAnswer)
                check_term(answer, time.time_ns())
                return OrderAnswered(worker, answer)
            case WorkerKey(worker, WorkerTopic.REPORT):
                report: Report = decode(message.payload, Report)  # type: ignore[arg-type] # a union
                mark("arrived", report, message.at_ns)
                mark("taken", report, now_ns)
                mark("decoded", report)
                self._health.happened("reports")
                # Who speaks is told by the key, which access control guards; not by the message.
                return ReportArrived(worker, self._fitting(worker, report))
            case _:
                problem = message.key
                raise MalformedMessageError(expected="key of a coordinator's", problem=problem)

    def _read_map(self, payload: bytes) -> None:
        """Unpack a map in a thread of its own: the largest takes seconds. One at a time."""

        def read() -> None:
            try:
                grid_map = from_message(decode(payload, MapMessage))
                self._recorder.on_map(grid_map)
                self._inbox.put_own(FreeGround.of(grid_map))
            except MalformedMessageError as error:
                self._inbox.put_own(error)

        if self._map_reader is None or not self._map_reader.is_alive():
            self._map_reader = threading.Thread(target=read, daemon=True)
            self._map_reader.start()

    def _fitting(self, worker: str, report: Report) -> Report:
        """A report of a size that the settings allow.

        A snapshot that is too large is left out, and the rest counts: the worker may have begun
        the job by settings of before.
        """
        settings = self._coordinator.filter_settings
        check_places(report, settings)
        if not has_too_large_snapshot(report, settings):
            return report
        detail = f"{worker}, job {printable(report.job_id)}"
        self._causes.warn(_log, "snapshot with too many particles", detail, time.monotonic())
        return without_snapshot(report)

    def _warn_of_another_map(self, scan: Scan) -> None:
        """Say which map is meant; the coordinator itself counts the scan and drops it."""
        expected = self._coordinator.map_digest
        if expected not in ("", scan.map_digest):
            error = MapMismatchError(worker=scan.sender, expected=expected, found=scan.map_digest)
            self._another_map.warn(_log, "scan of another map dropped", error, time.monotonic())

    def _on_health(self, key: str, health: Health, now_ns: int) -> None:
        if key != keys.BRIDGE_HEALTH:
            health = msgspec.structs.replace(health, sender=keys.worker_name(key))
        if not self._board.heard(key, health, now_ns):
            problem = f"{key}, besides {MAX_PROCESSES} others"
            self._causes.warn(_log, "too many processes", problem, time.monotonic())

    def _status(self, now_ns: int) -> Status:
        status = self._coordinator.status(now_ns, self._health.dropped() | self._recorder.lost)
        own = msgspec.structs.replace(
            self._health.health(), sender=status.sender, dropped=status.counters
        )
        return msgspec.structs.replace(status, processes=(own, *self._board.all(now_ns)))

    def _on_link(self, event: Link, now_ns: int) -> list[Instruction]:
        was_linked = self._membership.linked
        self._membership.link(event.up, now_ns)
        if event.up == was_linked:
            return []
        _log.warning("the link to the router %s", "is back" if event.up else "is lost")
        if event.up:
            self._fencing.listen(now_ns)
            return self._recorder.handle(LinkBack(), now_ns)
        return self._recorder.handle(LinkLost(), now_ns)

    def _change(self, changes: Iterable[Change], now_ns: int) -> list[Instruction]:
        """Act upon what has become certain of the workers."""
        return [do for change in changes for do in self._recorder.handle(change, now_ns)]

    def _on_query(self, asked: Asked, now_ns: int) -> list[Instruction]:
        self._health.happened("questions")
        if self._fencing.is_listening(now_ns):
            asked.refuse("another coordinator may have taken over; ask again")
            return []
        match asked.key:
            case keys.POSE:
                asked.answer(self._coordinator.pose(now_ns))
            case keys.HYPOTHESES:
                asked.answer(self._coordinator.hypotheses(now_ns))
            case keys.EVENTS:
                asked.answer(self._coordinator.events())
            case keys.STATUS:
                asked.answer(self._status(now_ns))
            case _:
                return self._on_command(asked, now_ns)
        return []

    def _on_command(self, asked: Asked, now_ns: int) -> list[Instruction]:
        """Carry out a command once, however often it is asked."""
        kind: type[SetPose | Relocalize]
        kind = SetPose if asked.key == keys.SET_POSE else Relocalize
        try:
            command = decode(asked.payload, kind)
        except MalformedMessageError as error:
            asked.refuse(str(error))
            raise
        instructions = self._recorder.handle(CommandArrived(command), now_ns)
        self._carry_out(instructions)  # others know of it before it is answered
        for instruction in instructions:
            if isinstance(instruction, AnswerCommand):
                asked.answer(instruction.done)
        return []

    def _carry_out(self, instructions: list[Instruction]) -> None:
        if self._coordinator.outranked_by is not None:
            return
        cleared = self._fencing.cleared(instructions, time.monotonic_ns())
        for instruction in cleared:
            match instruction:
                case PublishCheckpoint(checkpoint):
                    self._keeper.offer(checkpoint)
                case PublishBelief():
                    self._health.happened("beliefs")
        self._outgoing.carry_out(cleared)
