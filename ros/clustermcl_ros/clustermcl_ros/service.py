"""The engine that is a system of processes over Zenoh, which runs or which the node starts."""

import logging
import time
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from functools import partial

from msgspec.structs import replace

from clustermcl.commands.stack import ProcessEndedError, Stack, temporary_folder
from clustermcl.link.node import Node
from clustermcl.link.wire import Asked, Publisher, Received
from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, CommandDone, Configure, Status
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.protocol.work import Reported, TrackReport
from clustermcl.ros2.port import Port
from clustermcl.ros2.sides import Command, EngineStatus, Reading
from clustermcl.runtime.settings import Settings, ZenohSettings
from clustermcl.runtime.stop import StopFlag

_TURN_S = 0.1
_KEPT_MESSAGES = 64
_STATUS_EVERY_S = 1.0
_COMMAND_TIMEOUT_S, _ADVICE_TIMEOUT_S = 5.0, 20.0

_log = logging.getLogger(__name__)


class SystemEngine:
    """Sends readings and commands; `run` calls `port`, and restarts a stack's processes."""

    def __init__(self, node: Node, port: Port, stack: Stack | None) -> None:
        self._node, self._port, self._stack = node, port, stack
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

    def run(self, stop: StopFlag) -> None:
        """Run until `stop` is set.

        Raises:
            ProcessEndedError: a process of the stack refuses to start.
        """
        self._node.stop = stop
        if self._stack is not None:
            self._stack.start_all()
        with closing(self._node):
            self._node.open()
            while not stop.is_set():
                self._node.turn(_TURN_S)
                if (now_s := time.monotonic()) >= self._next_status_s:
                    self._next_status_s = now_s + _STATUS_EVERY_S
                    self._ask_status()
                for ended in self._stack.supervisor.poll(now_s) if self._stack else ():
                    if ended.restart_in_s is None:
                        raise ProcessEndedError(ended)
                    again = f"starting it again in {ended.restart_in_s:.1f} s"
                    _log.warning("%s ended with code %d; %s", ended.name, ended.code, again)

    def _ask_status(self) -> None:
        ask = partial(self._node.ask, timeout_s=_COMMAND_TIMEOUT_S)
        ask(keys.STATUS, Status, self._on_status, lambda _problem: self._port.on_status(None))
        if not self._has_changes:  # they are published only when they change
            ask(keys.CHANGES, Changes, self._on_changes)

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
        ask = partial(self._node.ask, timeout_s=_ADVICE_TIMEOUT_S)
        on_advice = self._port.on_advice
        ask(keys.ADVICE, Advice, on_advice, lambda problem: refuse(problem or "no answer"))

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


@contextmanager
def system_engine(settings: Settings, port: Port) -> Iterator[SystemEngine]:
    """Return an engine that stands before the system at the setting `zenoh.router`.

    With that setting unchanged, it starts a system whose router listens at a Unix socket in a
    folder of its own, so that nothing listens at a port.
    """
    with ExitStack() as resources:
        stack = None
        if settings.zenoh.router == ZenohSettings().router:
            folder = resources.enter_context(temporary_folder())
            zenoh = replace(settings.zenoh, router=f"unixsock-stream/{folder}/router.sock")
            bridge = replace(settings.bridge, map=settings.bridge.map or "zenoh")
            settings = replace(settings, zenoh=zenoh, bridge=bridge)
            stack = resources.enter_context(closing(Stack(settings, folder, logs_in_folder=False)))
        node = Node("amcl", "ros2", settings, StopFlag(), peers=keys.COORDINATOR_ALIVE)
        yield SystemEngine(node, port, stack)
