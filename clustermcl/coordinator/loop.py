"""Connects a `Replica` to Zenoh: passes messages on to it, and carries out its instructions."""

import logging
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import partial

from msgspec.structs import replace

from clustermcl.belief.free_ground import FreeGround
from clustermcl.coordinator import events
from clustermcl.coordinator import instructions as do
from clustermcl.coordinator.coordinator import Coordinator
from clustermcl.coordinator.recorder.flight_recorder import FlightRecorder
from clustermcl.coordinator.replica import Replica
from clustermcl.coordinator.report_checks import checked, without_malformed_jobs
from clustermcl.coordinator.state_file import StateKeeper
from clustermcl.link.node import Node
from clustermcl.link.wire import Asked, Link, Received, Token, alive
from clustermcl.protocol import keys, work
from clustermcl.protocol.advice import USUAL_RADIUS_M, Advice, AdviceQuestion
from clustermcl.protocol.answers import Belief, CommandDone, PoseAnswer, Relocalize, SetPose, Status
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.codec import decode
from clustermcl.protocol.errors import printable
from clustermcl.protocol.health import Health
from clustermcl.protocol.job_events import JobEvents, event_texts
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import MapMessage, OdometryReading, Scan, ScanHistory
from clustermcl.protocol.work import check_term
from clustermcl.recordings.maps.map_message import from_message

ROSTER_TIMEOUT_S = 1.0
TICK_S = 0.05
TICK_NS = int(TICK_S * 1e9)
ASK_AGAIN_WITHIN_S = 0.5
"""A query for scans is repeated for this time: a new link does not reach the bridge at once [s]."""
ADVICE_TIMEOUT_S, SILENT_AFTER_S = 20.0, 9.0
"""Time for a worker's advice; the shorter one if there is another worker to ask [s]."""
ADVISERS = 2
"""Number of workers to ask, one after the other."""
ORDER_TIMEOUT_S = 35.0
"""Time for an answer: a worker may fetch a large map first. Orders are repeated sooner [s]."""
FORGOTTEN_AFTER_NS = 30_000_000_000
"""A process that has published no health for longer is not listed [ns]."""
MAX_PROCESSES = 1_000
"""Largest number of listed processes; a client may invent names."""
MAY_BE_DEPOSED = "another coordinator may have taken over; ask again"

_log = logging.getLogger(__name__)


class Loop:
    """The event loop of a coordinator process, first as a follower, then as a leader."""

    def __init__(self, node: Node, replica: Replica, radius_m: float) -> None:
        self._node, self._replica = node, replica
        self._radius_m = radius_m or USUAL_RADIUS_M
        self._ticked_ns, self._linked = 0, True
        node.subscribe(
            keys.CHECKPOINT,
            work.Checkpoint,
            self._on_checkpoint,
            kind="checkpoint",
            kept=4,
            own=False,
        )
        node.watch_link(self._on_link)

    def follow(self) -> bool:
        """Watch the leader; return True when this process must lead, False when it was stopped."""
        node, replica = self._node, self._replica
        node.peers = keys.COORDINATOR_ALIVE
        node.watch(keys.COORDINATOR_ALIVE, self._on_token)
        replica.follow(time.monotonic_ns())
        _log.info("standing by: the robot has a coordinator")
        while not node.stop.is_set():
            event = node.turn(TICK_S)
            if event is None and replica.is_leader_dead(time.monotonic_ns()):
                if not node.replace_stale_session():
                    return True
                replica.follow(time.monotonic_ns())
        return False

    def lead(self, coordinator: Coordinator, keeper: StateKeeper, recorder: FlightRecorder) -> None:
        """Recover and lead until the process is stopped, or another coordinator deposes it."""
        self._coordinator, self._keeper, self._recorder = coordinator, keeper, recorder
        self._processes = ProcessRegistry()
        self._is_map_asked = False
        node, replica = self._node, self._replica
        node.peers = keys.ALL_WORKERS_ALIVE
        replica.lead(coordinator, time.monotonic_ns(), recorder.handle)
        self._events = node.publisher(keys.EVENTS)
        self._belief, self._pose = node.publisher(keys.BELIEF), node.publisher(keys.POSE)
        self._checkpoints = node.publisher(keys.CHECKPOINT)
        node.subscribe(keys.SCAN, Scan, self._on_scan, kind="scan", kept=256)
        node.subscribe(keys.ODOMETRY, OdometryReading, self._on_odometry, kind="odometry", kept=1)
        node.subscribe(
            keys.ALL_REPORTS,
            work.Reported,  # type: ignore[arg-type] # a union
            self._on_reported,
            kind="report",
            kept=4096,
        )
        for key in (keys.BRIDGE_HEALTH, keys.ALL_WORKERS_HEALTH):
            node.subscribe(key, Health, self._on_health, kind="health", kept=1024)
        # Without these tokens the coordinator would begin before it has asked any worker.
        for key in alive(node.session, keys.ALL_WORKERS_ALIVE, ROSTER_TIMEOUT_S):
            node.attempt(self._on_token, Token(key, alive=True))
        node.watch(keys.ALL_WORKERS_ALIVE, self._on_token)
        is_announced, is_serving, begun_s = False, False, time.monotonic()
        with recorder.running(), keeper.running():
            while not node.stop.is_set() and replica.role != "deposed":
                if replica.role == "leading" and not is_announced:
                    node.announce(keys.COORDINATOR_ALIVE)  # a recording goes on
                    is_announced = True
                if is_announced and not is_serving and self._may_serve(begun_s):
                    self._serve()
                    is_serving = True
                event = node.turn(TICK_S)
                # With many queries, `turn` may never return without an event.
                if event is None or time.monotonic_ns() - self._ticked_ns >= TICK_NS:
                    self._ticked_ns = time.monotonic_ns()
                    self._on(events.TimePassed())

    def _may_serve(self, begun_s: float) -> bool:
        """Return whether the age of the robot's data is known, or they are stale for certain."""
        pose = self._coordinator.state.pose
        return not pose.is_age_guessed or time.monotonic() - begun_s > pose.settings.stale_after_s

    def _serve(self) -> None:
        coordinator = self._coordinator
        answers: dict[str, Callable[[int], Message]] = {
            keys.POSE: coordinator.pose,
            keys.HYPOTHESES: coordinator.hypotheses,
            keys.EVENTS: lambda _now_ns: coordinator.events(),
            keys.STATUS: self._status,
        }
        served: dict[str, Callable[[Asked], None]] = {
            keys.ADVICE: self._on_advice_query,
            keys.SET_POSE: partial(self._on_command, SetPose),
            keys.RELOCALIZE: partial(self._on_command, Relocalize),
            **{key: partial(self._on_query, answer) for key, answer in answers.items()},
        }
        for key, serve in served.items():
            self._node.serve(key, partial(self._on_asked, serve))
        _log.info("coordinator ready")

    # --- messages

    def _on(self, event: events.Event | events.TokenChanged) -> list[do.Instruction]:
        """Pass an event to the replica; carry out and return the instructions."""
        decided = self._replica.handle(event, time.monotonic_ns())
        released = self._replica.release(decided, time.monotonic_ns())
        self._carry_out(released)
        return released

    def _on_link(self, link: Link) -> None:
        if link.up != self._linked:
            self._linked = link.up
            _log.warning("the link to the router %s", "is back" if link.up else "is lost")
        self._on(events.LinkChanged(link.up))

    def _on_token(self, token: Token) -> None:
        is_coordinator = token.key == keys.COORDINATOR_ALIVE
        worker = None if is_coordinator else keys.worker_name(token.key)
        self._on(events.TokenChanged(worker, token.alive))

    def _on_checkpoint(self, checkpoint: work.Checkpoint, _received: Received) -> None:
        check_term(checkpoint, time.time_ns())
        self._on(events.CheckpointArrived(checkpoint))

    def _on_scan(self, scan: Scan, _received: Received) -> None:
        self._node.health.happened("scans")
        self._on(events.ScanArrived(scan))

    def _on_odometry(self, reading: OdometryReading, _received: Received) -> None:
        self._node.health.happened("odometry")
        self._on(events.OdometryArrived(reading))

    def _on_reported(self, message: work.Reported, received: Received) -> None:
        # The worker's name is taken from the key, which access control protects.
        worker = keys.worker_name(received.key)
        for report in work.reports_in(message):
            self._node.health.happened("reports")
            usable = checked(report, self._coordinator.state.ensemble.settings)
            if usable is not report:
                detail = f"{worker}, job {printable(report.job_id)}"
                self._node.warn(_log, Cause.LARGE_SNAPSHOT, detail)
            self._on(events.ReportArrived(worker, usable))

    def _on_health(self, health: Health, received: Received) -> None:
        key = received.key
        if key != keys.BRIDGE_HEALTH:
            health = replace(health, sender=keys.worker_name(key))
        if not self._processes.on_health(key, health, time.monotonic_ns()):
            detail = f"{key}, more than {MAX_PROCESSES} processes"
            self._node.warn(_log, Cause.TOO_MANY_PROCESSES, detail)

    # --- queries

    def _on_asked(self, answer: Callable[[Asked], None], asked: Asked) -> None:
        """Answer a query, unless another coordinator may lead."""
        self._node.health.happened("questions")
        if self._replica.may_answer(time.monotonic_ns()):
            answer(asked)
        else:
            asked.refuse(MAY_BE_DEPOSED)

    def _on_query(self, answer: Callable[[int], Message], asked: Asked) -> None:
        asked.answer(answer(time.monotonic_ns()))

    def _on_advice_query(self, asked: Asked) -> None:
        match self._coordinator.advice_question(self._radius_m):
            case Advice() as known:
                asked.answer(known)
            case workers, question:
                self._ask_advice(asked, workers[:ADVISERS], question)

    def _ask_advice(self, asked: Asked, workers: Sequence[str], question: AdviceQuestion) -> None:
        """Ask a worker, and the next one if it is silent, as a frozen one is."""
        worker, *others = workers

        def on_failure(problem: str) -> None:
            if others and not problem:
                self._ask_advice(asked, others, question)
            else:
                asked.refuse(problem or f"{worker} did not answer")

        self._node.ask(
            keys.worker_advice(worker),
            Advice,
            asked.answer,
            on_failure,
            timeout_s=SILENT_AFTER_S if others else ADVICE_TIMEOUT_S,
            message=question,
        )

    def _status(self, now_ns: int) -> Status:
        health = self._node.health
        status = self._coordinator.status(now_ns, health.dropped() | self._recorder.lost)
        own = replace(health.health(), sender=status.sender, dropped=status.counters)
        return replace(status, processes=(own, *self._processes.all(now_ns)))

    def _on_command(self, kind: type[SetPose | Relocalize], asked: Asked) -> None:
        for one in self._on(events.CommandArrived(decode(asked.payload, kind))):
            if isinstance(one, CommandDone):
                asked.answer(one)
                return
        asked.refuse(MAY_BE_DEPOSED)

    # --- instructions

    def _carry_out(self, instructions: Iterable[do.Instruction]) -> None:
        for instruction in instructions:
            match instruction:
                case do.SendOrder(worker, order):
                    self._ask_worker(keys.worker_order(worker), order, work.OrderAnswer, worker)
                case do.AskState(worker, question):
                    self._ask_worker(keys.worker_state(worker), question, work.WorkerState, worker)
                case do.FetchScans(first, last):
                    self._node.ask(
                        keys.scan_history(first, last),
                        ScanHistory,
                        lambda history: self._on(events.HistoryArrived(history.scans)),
                        timeout_s=ORDER_TIMEOUT_S,
                        repeat_for_s=ASK_AGAIN_WITHIN_S,
                    )
                case do.FetchMap():
                    self._node.ask(keys.MAP, MapMessage, self._read_map, timeout_s=ORDER_TIMEOUT_S)
                case work.Checkpoint():
                    self._keeper.offer(instruction)
                    self._checkpoints.put(instruction)
                case JobEvents():
                    self._events.put(instruction)
                    for text in event_texts(instruction.events):
                        _log.info("%s", text)
                case Belief():
                    self._node.health.happened("beliefs")
                    self._belief.put(instruction)
                case PoseAnswer():
                    self._pose.put(instruction)
                case CommandDone():
                    pass  # see `_on_command`

    def _ask_worker(
        self,
        key: str,
        message: Message,
        answer: type[work.OrderAnswer | work.WorkerState],
        worker: str,
    ) -> None:
        def on_answer(received: work.OrderAnswer | work.WorkerState) -> None:
            check_term(received, time.time_ns())
            if isinstance(received, work.OrderAnswer):
                self._on(events.OrderAnswered(worker, received))
            else:
                self._node.trim_heap_soon()
                self._on(events.WorkerStateArrived(worker, without_malformed_jobs(received)))

        self._node.ask(key, answer, on_answer, timeout_s=ORDER_TIMEOUT_S, message=message)

    def _read_map(self, message: MapMessage) -> None:
        """Unpack a map in the background, because a large map takes seconds."""

        def unpacked() -> FreeGround:
            grid_map = from_message(message)
            self._recorder.on_map(grid_map)
            return FreeGround.of(grid_map)

        def on_done(outcome: Future[FreeGround]) -> None:
            self._is_map_asked = False
            self._on(events.MapArrived(outcome.result()))

        self._node.trim_heap_soon()
        if not self._is_map_asked:
            self._is_map_asked = True
            self._node.in_background(unpacked, on_done)


class ProcessRegistry:
    """The newest health message of each process."""

    def __init__(self) -> None:
        self._newest: dict[str, tuple[int, Health]] = {}

    def on_health(self, key: str, health: Health, now_ns: int) -> bool:
        """Store a process's health; return False if there are too many processes."""
        if len(self._newest) >= MAX_PROCESSES:
            self.all(now_ns)
        if len(self._newest) >= MAX_PROCESSES and key not in self._newest:
            return False
        self._newest[key] = (now_ns, health)
        return True

    def all(self, now_ns: int) -> tuple[Health, ...]:
        """Return each process's newest health with its age, by role and name; forget the silent."""
        last_ns = now_ns - FORGOTTEN_AFTER_NS
        self._newest = {key: one for key, one in self._newest.items() if one[0] > last_ns}
        aged = (replace(one, age_s=(now_ns - at_ns) / 1e9) for at_ns, one in self._newest.values())
        return tuple(sorted(aged, key=lambda one: (one.role, one.sender)))
