"""The rim of the coordinator: Zenoh in, Zenoh out; what happens between is `Coordinator`."""

import logging
import time
from collections.abc import Iterable

import msgspec
import zenoh
from zenoh import handlers

from coordinator.coordinator import (
    Coordinator,
    FetchScans,
    Instruction,
    PublishBelief,
    SendOrder,
)
from coordinator.health_board import MAX_PROCESSES, HealthBoard
from coordinator.roster import Change, Roster
from process_runtime.health import HealthReporter
from process_runtime.inbox import Inbox
from process_runtime.logs import CauseCounter
from process_runtime.stop import StopFlag
from process_runtime.wire import (
    Asked,
    Event,
    Events,
    Link,
    Publisher,
    Received,
    Token,
    serve,
    subscribe,
    watch,
    watch_link,
)
from protocol import keys
from protocol.answers import CommandDone, Relocalize, SetPose, Status
from protocol.codec import decode, encode
from protocol.errors import MalformedMessageError
from protocol.health import Health
from protocol.message import Message
from protocol.steps import OdometryReading, Scan, ScanHistory
from protocol.work import OrderAnswer, Report

ORDER_TIMEOUT_S = 35.0
"""A worker that fetches a large map before it answers takes long; orders are repeated sooner."""
TICK_S = 0.05

_log = logging.getLogger(__name__)


class CoordinatorLoop:
    """One coordinator's life between its connection and its stop."""

    def __init__(self, coordinator: Coordinator, session: zenoh.Session) -> None:
        self._coordinator, self._session = coordinator, session
        self._inbox: Events = Inbox({"scan": 256, "odometry": 1, "report": 4096, "health": 1024})
        self._causes = CauseCounter()
        self._health = HealthReporter("coordinator", "coordinator", self._causes, self._inbox)
        self._board = HealthBoard()
        self._roster = Roster()
        self._belief = Publisher(session, keys.BELIEF)
        self._pose = Publisher(session, keys.POSE)
        self._commands_done: dict[str, CommandDone] = {}

    def run(self, stop: StopFlag) -> None:
        """Coordinate until told to stop."""
        subscribe(self._session, keys.SCAN, self._inbox, "scan")
        subscribe(self._session, keys.ODOMETRY, self._inbox, "odometry")
        subscribe(self._session, keys.ALL_REPORTS, self._inbox, "report")
        for key in (keys.BRIDGE_HEALTH, keys.ALL_WORKERS_HEALTH):
            subscribe(self._session, key, self._inbox, "health")
        for key in (keys.POSE, keys.HYPOTHESES, keys.STATUS, keys.SET_POSE, keys.RELOCALIZE):
            serve(self._session, key, self._inbox)
        watch_link(self._session, self._inbox)
        watch(self._session, keys.ALL_WORKERS_ALIVE, self._inbox)
        with self._session.liveliness().declare_token(keys.COORDINATOR_ALIVE):
            _log.info("coordinator ready")
            while not stop.is_set():
                event = self._inbox.get(TICK_S)
                now_ns = time.monotonic_ns()
                self._carry_out(self._handle(event, now_ns))
                self._carry_out(self._change(self._roster.due(now_ns), now_ns))

    def _handle(self, event: Event | None, now_ns: int) -> list[Instruction]:
        try:
            match event:
                case Received():
                    return self._on_message(event, now_ns)
                case Asked():
                    return self._on_query(event, now_ns)
                case Token():
                    name = keys.worker_name(event.key)
                    return self._change(self._roster.token(name, event.alive, now_ns), now_ns)
                case Link():
                    return self._on_link(event, now_ns)
        except MalformedMessageError as error:
            self._causes.warn(_log, error.cause, error, time.monotonic())
        return self._coordinator.tick(now_ns)

    def _on_message(self, event: Received, now_ns: int) -> list[Instruction]:
        match event.key:
            case keys.SCAN:
                scan = decode(event.payload, Scan)
                self._health.happened("scans")
                return self._coordinator.scan(scan, now_ns)
            case keys.ODOMETRY:
                self._health.happened("odometry")
                self._coordinator.odometry(decode(event.payload, OdometryReading), now_ns)
                return []
            case keys.SCAN_HISTORY:
                scans = decode(event.payload, ScanHistory).scans
                return [done for scan in scans for done in self._coordinator.scan(scan, now_ns)]
            case key if key.endswith("/order"):
                answer = decode(event.payload, OrderAnswer)
                self._coordinator.order_answered(keys.worker_name(key), answer)
                return []
            case key if key.endswith("/health"):
                self._on_health(key, decode(event.payload, Health), now_ns)
                return []
            case _:
                report: Report = decode(event.payload, Report)  # type: ignore[arg-type] # a union
                self._health.happened("reports")
                # Who speaks is told by the key, which access control guards; not by the message.
                return self._coordinator.report(report, keys.worker_name(event.key), now_ns)

    def _on_health(self, key: str, health: Health, now_ns: int) -> None:
        if key != keys.BRIDGE_HEALTH:
            health = msgspec.structs.replace(health, sender=keys.worker_name(key))
        if not self._board.heard(key, health, now_ns):
            problem = f"{key}, besides {MAX_PROCESSES} others"
            self._causes.warn(_log, "too many processes", problem, time.monotonic())

    def _status(self, now_ns: int) -> Status:
        status = self._coordinator.status(now_ns, self._health.dropped())
        own = msgspec.structs.replace(
            self._health.health(), sender=status.sender, dropped=status.counters
        )
        return msgspec.structs.replace(status, processes=(own, *self._board.all(now_ns)))

    def _on_link(self, event: Link, now_ns: int) -> list[Instruction]:
        was_linked = self._roster.linked
        self._roster.link(event.up, now_ns)
        if event.up == was_linked:
            return []
        _log.warning("the link to the router %s", "is back" if event.up else "is lost")
        if event.up:
            return self._coordinator.link_back(now_ns)
        self._coordinator.link_lost()
        return []

    def _change(self, changes: Iterable[Change], now_ns: int) -> list[Instruction]:
        """Act upon what has become certain of the workers."""
        what = {
            "joined": self._coordinator.worker_joined,
            "left": self._coordinator.worker_left,
            "returned": self._coordinator.worker_returned,
        }
        return [do for change in changes for do in what[change.what](change.worker, now_ns)]

    def _on_query(self, asked: Asked, now_ns: int) -> list[Instruction]:
        self._health.happened("questions")
        match asked.key:
            case keys.POSE:
                asked.answer(self._coordinator.pose(now_ns))
            case keys.HYPOTHESES:
                asked.answer(self._coordinator.hypotheses(now_ns))
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
        done = self._commands_done.get(command.command_id)
        if done is not None:
            asked.answer(done)
            return []
        instructions: list[Instruction] = []
        done = CommandDone(sender="coordinator")
        try:
            if isinstance(command, SetPose):
                instructions = self._coordinator.set_pose(command, now_ns)
            else:
                instructions = self._coordinator.relocalize(now_ns)
        except ValueError as error:
            done = CommandDone(sender="coordinator", problem=str(error))
        self._commands_done[command.command_id] = done
        while len(self._commands_done) > 100:
            del self._commands_done[next(iter(self._commands_done))]
        asked.answer(done)
        return instructions

    def _carry_out(self, instructions: Iterable[Instruction]) -> None:
        for instruction in instructions:
            match instruction:
                case SendOrder(worker, order):
                    self._ask(keys.worker_order(worker), order)
                case FetchScans(first, last):
                    self._ask(keys.scan_history(first, last))
                case PublishBelief(belief, pose):
                    self._health.happened("beliefs")
                    self._belief.put(belief)
                    self._pose.put(pose)

    def _ask(self, selector: str, message: Message | None = None) -> None:
        """Ask without waiting; the answer comes through the inbox."""

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
