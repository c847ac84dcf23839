"""Run one robot's bridge: a session to the robot's ROS nodes, a node of ours, and one loop."""

import logging
import time
from collections.abc import Mapping
from contextlib import ExitStack, closing
from typing import Any

from clustermcl.link.node import Node
from clustermcl.protocol import keys
from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.causes import AnyCause, Cause
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.work import Particles
from clustermcl.ros2 import topics
from clustermcl.ros2.bond import BondThread, BridgeState, RestartFile
from clustermcl.ros2.lifecycle import ACTIVATE, CONFIGURE, State
from clustermcl.ros2.message_types import decode, encode, request_of, response_of
from clustermcl.ros2.node import Called, FromRos, RosNode, RosPublisher, log_to_ros
from clustermcl.ros2.parameter_table import Value
from clustermcl.ros2.port import EngineStatus, Port
from clustermcl.ros2.robot_session import look_at_graph, node_name, open_robot_session
from clustermcl.ros2.service_engine import ServiceEngine
from clustermcl.ros2.services import Services
from clustermcl.ros2.topics import Topic, Topics
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.stop import StopFlag

_log = logging.getLogger(__name__)

_KEPT_MESSAGES, _KEPT_TRANSFORMS = 64, 500
_POLL_S = 0.05
_TICK_WITHIN_S = 0.1


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
        bond = BondThread(publishers[topics.BOND.name].put, settings.ros2.node_name)
        resources.callback(bond.end)
        file = RestartFile(
            settings.coordinator.state_folder,
            f"{settings.robot.name}-{name.domain_id}{full_name}",
        )
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
        self._clock_ns = 0
        self._engine = ServiceEngine(node, self)
        self._port = Port(settings, self, self._engine)
        self.services = Services(self._port, self, full_name)
        node.on_other = self._on_ros

    def run(self) -> None:
        before = self._file.read()
        if before is not None and before.state is not State.UNCONFIGURED:
            self._resume(before)
        elif self._settings.ros2.autostart:
            self.services.change(CONFIGURE)
            self.services.change(ACTIVATE)
        port, tick_s = self._port, 0.0
        while not self._node.stop.is_set():
            event = self._engine.turn(0.0 if port.has_places else _POLL_S)
            if event is None or time.monotonic() >= tick_s:
                tick_s = time.monotonic() + _TICK_WITHIN_S
                port.tick()
            bridge_state = BridgeState(
                state=self.services.lifecycle.state, bond=self._bond.instance_id, held=port.held
            )
            self._file.keep(bridge_state, time.monotonic())

    def _resume(self, before: BridgeState) -> None:
        """Continue in the state of a killed bridge; the coordinator still knows the pose."""
        _log.info("%s again: continuing the state of the killed bridge", before.state.label)
        self.services.lifecycle.state = before.state
        if before.state is State.ACTIVE:
            self._port.resume(before.held)
            self._bond.begin(before.bond)
        else:
            self._port.enter(before.state)

    # --- from ROS

    def _on_ros(self, event: FromRos | Called) -> None:
        match event:
            case FromRos(problem=problem) if problem:
                self.refuse(Cause.NOT_ROS, f"{event.topic.name}: {problem}")
            case FromRos():
                message = decode(event.payload, event.topic.ros_type)
                if event.topic == topics.CLOCK:
                    self._clock_ns = message.clock.sec * 10**9 + message.clock.nanosec
                self._port.on_message(event.topic, message)
            case Called():
                self._on_call(event)

    def _on_call(self, call: Called) -> None:
        ros_type = self.services.types()[call.service]
        try:
            if call.problem:
                raise MalformedMessageError(expected="ROS service call", problem=call.problem)
            request = decode(call.payload, request_of(ros_type))
        except MalformedMessageError:
            call.drop()
            raise
        response = self.services.call(call.service, request)
        call.respond(encode(response, response_of(ros_type)))

    # --- from the engine

    def on_belief(self, belief: Belief) -> None:
        self._port.on_belief(belief)

    def on_particles(self, cluster: int, particles: Particles) -> None:
        self._port.on_particles(cluster, particles)

    def on_changes(self, changes: Changes) -> None:
        self._port.on_changes(changes)

    def on_advice(self, advice: Advice) -> None:
        self._port.on_advice(advice)

    def on_status(self, status: EngineStatus | None) -> None:
        self._port.on_status(status)

    def on_refused(self, cause: AnyCause, detail: str) -> None:
        self.refuse(cause, detail)

    # --- from the port

    def publish(self, topic: Topic, message: Any) -> None:
        self._publishers[topic.name].put(message)

    def bond(self, *, alive: bool) -> None:
        if alive:
            self._bond.begin()
        else:
            self._bond.end()

    def show_parameters(self, values: Mapping[str, Value]) -> None:
        self.services.show(values)

    def refuse(self, cause: AnyCause, detail: str) -> None:
        self._node.warn(_log, cause, detail)

    def load_map(self, file: str) -> None:
        self._port.on_map_loaded(f"{file} cannot be loaded over rmw_zenoh: use the ROS package")

    def refused(self) -> Mapping[str, int]:
        return self._node.health.dropped()

    def now_ns(self) -> int:
        return self._clock_ns if self._settings.ros2.use_sim_time else time.time_ns()

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()
