"""Run one robot's bridge: a session to the robot's ROS nodes, a node of ours, and one loop."""

import logging
import math
import time
import uuid
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, closing

from msgspec.structs import replace

from clustermcl.link.node import Node
from clustermcl.link.wire import Asked, Publisher, Received
from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import (
    Belief,
    CommandDone,
    Configure,
    Relocalize,
    SetPose,
    Status,
    Update,
)
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.protocol.work import Reported, TrackReport
from clustermcl.ros2 import topics
from clustermcl.ros2.amcl import Amcl
from clustermcl.ros2.bond import BondThread, BridgeState, RestartFile
from clustermcl.ros2.lifecycle import ACTIVATE, CONFIGURE, State
from clustermcl.ros2.message_types import decode, encode, request_of, response_of
from clustermcl.ros2.messages_out import diagnostics
from clustermcl.ros2.node import Called, FromRos, RosNode, RosPublisher, log_to_ros
from clustermcl.ros2.outputs import AskAdvice, Bond, Command, Output, Publish, Reading, Refused
from clustermcl.ros2.robot_session import look_at_graph, node_name, open_robot_session
from clustermcl.ros2.services import Services
from clustermcl.ros2.topics import Topics
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag

_log = logging.getLogger(__name__)

_KEPT_MESSAGES, _KEPT_TRANSFORMS = 64, 500
_POLL_S = 0.05
_STATUS_EVERY_S = 1.0
_COMMAND_TIMEOUT_S, _ADVICE_TIMEOUT_S = 5.0, 20.0
_PLACES_WITHIN_S = 0.1
"""All places are published when the inbox is empty, at most this long after their belief."""


def serve_robot(settings: Settings, process: str, stop: StopFlag) -> None:
    """Run the node until `stop` is set; wait for the router and the robot if necessary.

    Raises:
        AlreadyRunningError: the robot already has a node of that name.
    """
    name, names = node_name(settings.ros2), Topics(settings.ros2)
    with ExitStack() as resources:
        humble = look_at_graph(settings, name, stop)
        robot = resources.enter_context(open_robot_session(settings, stop))
        peers = keys.COORDINATOR_ALIVE
        core = resources.enter_context(closing(Node(process, "ros2", settings, stop, peers=peers)))
        core.open()
        for topic in names.read():
            core.inbox.keep(topic.name, _KEPT_TRANSFORMS if topic == names.tf else _KEPT_MESSAGES)
        node = RosNode(robot, name, humble=humble)
        publishers = {topic.name: node.publisher(topic) for topic in names.sent()}
        full_name = name.topic(name.name)
        resources.enter_context(log_to_ros(publishers[topics.ROSOUT.name], full_name))
        bond = BondThread(publishers[topics.BOND.name], settings.ros2.node_name)
        resources.callback(bond.end)
        file = RestartFile(settings, full_name)
        resources.callback(file.remove)
        loop = BridgeLoop(settings, full_name, core, publishers, bond, file)
        for service, ros_type in loop.services.types().items():
            node.serve(service, ros_type, core.inbox)
        for topic in names.read():
            node.subscribe(topic, core.inbox)
        _log.info("%s is running in ROS domain %d", full_name, name.domain_id)
        loop.run()


class BridgeLoop:
    """Owns the state of the bridge, so there is no lock."""

    def __init__(
        self,
        settings: Settings,
        full_name: str,
        node: Node,
        publishers: Mapping[str, RosPublisher],
        bond: BondThread,
        file: RestartFile,
    ) -> None:
        self._settings, self._node = settings, node
        self._publishers, self._bond, self._file = publishers, bond, file
        self._amcl = Amcl(settings.ros2)
        self.services = Services(self._amcl, settings, self._clock_ns, full_name)
        self._topics = Topics(settings.ros2)
        self._map: MapReading | None = None
        self._next_status_s = 0.0
        self._places_until_s: float | None = None
        self._status: Status | None = None
        self._readings: dict[type[Reading], Publisher] = {
            LaserReading: node.publisher(keys.LASER_READING),
            OdometryReading: node.publisher(keys.ODOMETRY_READING),
            Observation: node.publisher(keys.OBSERVATION_READING),
            MapReading: node.publisher(keys.MAP_READING, may_wait=True),
        }
        node.on_other = self._on_ros
        node.serve(keys.MAP_READING, self._on_map_query)
        kept = _KEPT_MESSAGES
        node.subscribe(keys.BELIEF, Belief, self._on_belief, kind=keys.BELIEF, kept=kept)
        reports: type[TrackReport] = Reported  # type: ignore[assignment] # a union
        node.subscribe(keys.ALL_REPORTS, reports, self._on_report, kind=keys.ALL_REPORTS, kept=kept)

    def run(self) -> None:
        before = self._file.read()
        if before is not None and before.state is not State.UNCONFIGURED:
            self._resume(before)
        elif self._settings.ros2.autostart:
            self._do(self.services.change(CONFIGURE))
            self._do(self.services.change(ACTIVATE))
        while not self._node.stop.is_set():
            event = self._node.turn(_POLL_S if self._places_until_s is None else 0.0)
            if event is None:
                self._do(self._amcl.on_tick(time.monotonic_ns()))
            if event is None or time.monotonic() >= (self._places_until_s or math.inf):
                self._publish_all_places()
            self._every_second()
            state, held = self.services.lifecycle.state, self._amcl.choice.held
            bridge_state = BridgeState(state=state, bond=self._bond.instance_id, held=held)
            self._file.keep(bridge_state, time.monotonic())

    def _resume(self, before: BridgeState) -> None:
        """Continue in the state of a killed bridge; the coordinator still knows the pose."""
        _log.info("%s again: continuing the state of the killed bridge", before.state.label)
        self.services.lifecycle.state = before.state
        if before.state is State.ACTIVE:
            self._amcl.resume(before.held)
            self._bond.begin(before.bond)
            self._do([self.services.no_motion_update])  # otherwise a standing robot gets no belief

    def _on_ros(self, event: FromRos | Called) -> None:
        match event:
            case FromRos():
                self._on_message(event)
            case Called():
                self._on_call(event)

    def _on_belief(self, belief: Belief, _received: Received) -> None:
        self._do(self._amcl.on_belief(belief))
        if self._places_until_s is None:
            self._places_until_s = time.monotonic() + _PLACES_WITHIN_S

    def _on_report(self, report: Reported, _received: Received) -> None:
        if isinstance(report, TrackReport) and report.snapshot and report.cluster is not None:
            self._amcl.on_particles(report.cluster, report.snapshot)

    def _on_status(self, status: Status) -> None:
        self._status, self.services.freshness = status, status.freshness
        self._do(self.services.on_live_settings(status.settings))

    def _on_no_status(self, _problem: str) -> None:
        self._status, self.services.freshness = None, "unreachable"

    def _on_map_query(self, asked: Asked) -> None:
        if self._map is None:
            asked.refuse("no map has arrived yet")
        else:
            asked.answer(self._map)

    def _publish_all_places(self) -> None:
        if self._places_until_s is not None:
            self._places_until_s = None
            self._do(self._amcl.all_places())

    def _on_message(self, event: FromRos) -> None:
        if event.problem:
            self._refused(Refused(Cause.NOT_ROS, f"{event.topic.name}: {event.problem}"))
            return
        message = decode(event.payload, event.topic.ros_type)
        amcl, now_ns = self._amcl, time.monotonic_ns()
        match event.topic:
            case topic if topic in self._topics.scans:
                self._do(amcl.on_scan(message, now_ns))
            case self._topics.tf:
                self._do(amcl.on_transforms(message, now_ns, fixed=False))
            case self._topics.tf_static:
                self._do(amcl.on_transforms(message, now_ns, fixed=True))
            case self._topics.map:
                self._do(amcl.on_map(message))
            case topic if topic in self._topics.observed:
                self._do(amcl.on_observed(message, topic.name, now_ns))
            case topics.INITIAL_POSE:
                self._do(amcl.on_initial_pose(message))
            case topics.CLOCK:
                self._do(amcl.on_clock(message))

    def _on_call(self, call: Called) -> None:
        ros_type = self.services.types()[call.service]
        try:
            if call.problem:
                raise MalformedMessageError(expected="ROS service call", problem=call.problem)
            request = decode(call.payload, request_of(ros_type))
        except MalformedMessageError:
            call.drop()
            raise
        response, outputs = self.services.call(call.service, request)
        call.respond(encode(response, response_of(ros_type)))
        self._do(outputs)

    def _do(self, outputs: Iterable[Output]) -> None:
        for output in outputs:
            match output:
                case Publish(topic=topic, message=message):
                    self._publishers[topic.name].put(message)
                case Refused():
                    self._refused(output)
                case Bond(alive=True):
                    self._bond.begin()
                case Bond():
                    self._bond.end()
                case LaserReading() | OdometryReading() | Observation() | MapReading():
                    self._map = output if isinstance(output, MapReading) else self._map
                    self._readings[type(output)].put(output)
                case AskAdvice():
                    self._ask_advice()
                case Configure():
                    self._command(output)
                case SetPose() | Relocalize() | Update():
                    self._command(replace(output, command_id=uuid.uuid4().hex))

    def _ask_advice(self) -> None:
        self._node.ask(
            keys.ADVICE,
            Advice,
            lambda advice: self._do(self._amcl.on_advice(advice)),
            lambda problem: self._refused(Refused(Cause.NO_ADVICE, problem or "no answer")),
            timeout_s=_ADVICE_TIMEOUT_S,
        )

    def _refused(self, refused: Refused) -> None:
        self._node.warn(_log, refused.cause, refused.detail)

    def _every_second(self) -> None:
        now_s = time.monotonic()
        if now_s < self._next_status_s:
            return
        self._next_status_s = now_s + _STATUS_EVERY_S
        self._node.ask(
            keys.STATUS, Status, self._on_status, self._on_no_status, timeout_s=_COMMAND_TIMEOUT_S
        )
        self._publishers[topics.DIAGNOSTICS.name].put(self._diagnostics())

    def _diagnostics(self) -> object:
        status, belief = self._status, self._amcl.belief
        values: dict[str, object] = {"life cycle": self.services.lifecycle.state.label}
        if belief is not None and belief.hypotheses:
            values["places"] = len(belief.hypotheses)
            values["probability"] = f"{belief.probability:.3f}"
        if belief is not None:
            values["probability elsewhere"] = f"{belief.elsewhere_probability:.3f}"
            values["probability off the map"] = f"{belief.off_map_probability:.3f}"
        if status is not None:
            values |= {"step": status.step, "workers": len(status.workers)}
        values |= self._node.health.dropped()
        state = status.state if status is not None else "searching"
        node_name = self._settings.ros2.node_name
        return diagnostics(state, self.services.freshness, values, node_name, self._clock_ns())

    def _clock_ns(self) -> int:
        if self._settings.ros2.use_sim_time:
            return self._amcl.clock_ns or 0
        return time.time_ns()

    # --- messages to our system

    def _command(self, command: Command) -> None:
        def on_done(done: CommandDone) -> None:
            if done.problem:
                self._refused(Refused(Cause.COMMAND_REFUSED, f"{command.key}: {done.problem}"))

        def on_failure(problem: str) -> None:
            detail = f"{command.key}: {problem or 'no answer'}"
            self._refused(Refused(Cause.COMMAND_LOST, detail))

        self._node.ask(
            command.key,
            CommandDone,
            on_done,
            on_failure,
            timeout_s=_COMMAND_TIMEOUT_S,
            message=command,
            repeat_for_s=_COMMAND_TIMEOUT_S,  # the system may have just begun, or begin again
        )
