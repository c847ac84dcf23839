"""The engine that is a running system: processes that communicate over Zenoh."""

import time
import uuid
from functools import partial

from msgspec.structs import replace

from clustermcl.link.node import Node
from clustermcl.link.wire import Asked, Publisher, Received
from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, CommandDone, Configure, Status
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.protocol.work import Reported, TrackReport
from clustermcl.ros2.outputs import Command, Reading
from clustermcl.ros2.port import EngineStatus, Port

_KEPT_MESSAGES = 64
_STATUS_EVERY_S = 1.0
_COMMAND_TIMEOUT_S, _ADVICE_TIMEOUT_S = 5.0, 20.0


class ServiceEngine:
    """Sends readings and commands; calls `port` in the turns of the node's loop."""

    def __init__(self, node: Node, port: Port) -> None:
        self._node, self._port = node, port
        self._map: MapReading | None = None
        self._next_status_s, self._has_changes = 0.0, False
        self._readings: dict[type[Reading], Publisher] = {
            LaserReading: node.publisher(keys.LASER_READING),
            OdometryReading: node.publisher(keys.ODOMETRY_READING),
            Observation: node.publisher(keys.OBSERVATION_READING),
            MapReading: node.publisher(keys.MAP_READING, may_wait=True),
        }
        node.serve(keys.MAP_READING, self._on_map_query)
        kept = _KEPT_MESSAGES
        node.subscribe(keys.BELIEF, Belief, self._on_belief, kind=keys.BELIEF, kept=kept)
        node.subscribe(keys.CHANGES, Changes, self._on_changes, kind=keys.CHANGES, kept=1)
        reports: type[TrackReport] = Reported  # type: ignore[assignment] # a union
        node.subscribe(keys.ALL_REPORTS, reports, self._on_report, kind=keys.ALL_REPORTS, kept=kept)

    def turn(self, wait_s: float) -> object:
        """Let the node handle an event, as `Node.turn`; query the status each second."""
        event = self._node.turn(wait_s)
        if (now_s := time.monotonic()) >= self._next_status_s:
            self._next_status_s = now_s + _STATUS_EVERY_S
            self._node.ask(
                keys.STATUS,
                Status,
                self._on_status,
                lambda _problem: self._port.on_status(None),
                timeout_s=_COMMAND_TIMEOUT_S,
            )
            if not self._has_changes:  # they are published only when they change
                self._node.ask(
                    keys.CHANGES, Changes, self._on_changes, timeout_s=_COMMAND_TIMEOUT_S
                )
        return event

    def put(self, reading: Reading) -> None:
        if isinstance(reading, MapReading):
            self._map = reading
        if self._node.is_open:
            self._readings[type(reading)].put(reading)

    def command(self, command: Command) -> None:
        if not isinstance(command, Configure):
            command = replace(command, command_id=uuid.uuid4().hex)

        def on_done(done: CommandDone) -> None:
            if done.problem:
                self._port.on_refused(Cause.COMMAND_REFUSED, f"{command.key}: {done.problem}")

        def on_failure(problem: str) -> None:
            self._port.on_refused(Cause.COMMAND_LOST, f"{command.key}: {problem or 'no answer'}")

        self._node.ask(
            command.key,
            CommandDone,
            on_done,
            on_failure,
            timeout_s=_COMMAND_TIMEOUT_S,
            message=command,
            repeat_for_s=_COMMAND_TIMEOUT_S,  # the system may have just begun, or begin again
        )

    def ask_advice(self) -> None:
        refuse = partial(self._port.on_refused, Cause.NO_ADVICE)
        self._node.ask(
            keys.ADVICE,
            Advice,
            self._port.on_advice,
            lambda problem: refuse(problem or "no answer"),
            timeout_s=_ADVICE_TIMEOUT_S,
        )

    def _on_status(self, found: Status) -> None:
        workers, live = len(found.workers), found.settings
        status = EngineStatus(found.state, found.freshness, found.step, workers, live)
        self._port.on_status(status)

    def _on_belief(self, belief: Belief, _received: Received) -> None:
        self._port.on_belief(belief)

    def _on_changes(self, changes: Changes, _received: Received | None = None) -> None:
        self._has_changes = True
        self._port.on_changes(changes)

    def _on_report(self, report: Reported, _received: Received) -> None:
        if isinstance(report, TrackReport) and report.snapshot and report.cluster is not None:
            self._port.on_particles(report.cluster, report.snapshot)

    def _on_map_query(self, asked: Asked) -> None:
        if self._map is None:
            asked.refuse("no map has arrived yet")
        else:
            asked.answer(self._map)
