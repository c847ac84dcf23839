"""AMCL's node in the graph of ROS: its topics, services, parameters and lifecycle.

One thread runs the executor, and in it all decisions. An engine and the heartbeat have threads of
their own; an engine's results come back through `later`.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.clock import JumpThreshold
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.parameter import Parameter as RosParameter
from rclpy.qos import QoSDurabilityPolicy, QoSProfile, QoSReliabilityPolicy

from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.work import Particles
from clustermcl.ros2 import topics
from clustermcl.ros2.bond import BondThread, BridgeState
from clustermcl.ros2.lifecycle import State
from clustermcl.ros2.parameter_table import INSTEAD, PARAMETERS, ROS1_NAMES, Parameter, Value
from clustermcl.ros2.port import SERVICES, Engine, EngineStatus, Port
from clustermcl.ros2.topics import Topic, Topics
from clustermcl.ros2.wire import Qos
from clustermcl.runtime.logs import CauseCounter
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting
from clustermcl.runtime.settings_table import TABLE
from clustermcl_ros.messages import class_of

ENGINE = "engine"
_OF_RCLPY = ("use_sim_time", "start_type_description_service")
_SENT_TRANSFORMS = 200
_DONE = TransitionCallbackReturn.SUCCESS

_log = logging.getLogger(__name__)


class AmclNode(LifecycleNode):  # type: ignore[misc] # rclpy is not installed where types are checked
    """The node. `settings` are ours before the parameters; call `begin` with an engine."""

    def __init__(self, settings: Settings) -> None:
        super().__init__("amcl", automatically_declare_parameters_from_overrides=True)
        self.full_name = self.get_fully_qualified_name()
        self.settings = with_setting(settings, "ros2.node_name", self.get_name(), "ROS")
        self.engine = "inside"
        self._declare_parameters()
        self._names = Topics(self.settings.ros2)
        self._publishers_of = {topic: self._publisher(topic) for topic in self._names.sent()}
        self._sent: deque[tuple[int, int, float, float]] = deque(maxlen=_SENT_TRANSFORMS)
        """Stamps and positions of our own transforms, which ROS delivers to this node too."""
        self._bond = BondThread(self._publishers_of[topics.BOND].publish, self.get_name())
        self._causes, self._showing = CauseCounter(), False
        self._resumed: BridgeState | None = None
        self._load_map: Any = None
        self._calls: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._called = self.create_guard_condition(self._run_calls)

    def begin(self, engine: Engine) -> Port:
        """Begin to receive; `engine` calls the `on_...` methods of this node from any thread."""
        self._port = Port(self.settings, self, engine)
        for topic in self._names.read():
            kind = class_of(topic.ros_type)
            self.create_subscription(kind, topic.name, self._receive(topic), _qos(topic.qos))
        for name, ros_type in SERVICES.items():
            self.create_service(class_of(ros_type), name, self._serve(name))
        self.add_on_set_parameters_callback(self._on_set)
        backward = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jumps = self.get_clock().create_jump_callback(
            backward,
            post_callback=lambda jump: self.later(
                lambda: self._port.on_clock_set_back(-jump.delta.nanoseconds)
            ),
        )
        return self._port

    def end(self) -> None:
        self._bond.end()

    def later(self, act: Callable[[], object]) -> None:
        """Call a function in the executor's thread; safe in any thread."""
        self._calls.put(act)
        self._called.trigger()

    def _run_calls(self) -> None:
        with suppress(Empty):
            while True:
                self._calls.get_nowait()()

    # --- parameters

    def _declare_parameters(self) -> None:
        """Declare nav2's parameters and `engine`; use their values, and those of our settings."""
        self._rename_ros1()
        given = dict(self.get_parameters_by_prefix(""))
        for name, parameter in PARAMETERS.items():
            self._declare(name, parameter)
        if ENGINE not in given:
            self.declare_parameter(ENGINE, self.engine)
        self.engine = self.get_parameter(ENGINE).value
        if self.engine not in ("inside", "service"):
            raise SettingsError(f"{ENGINE} = {self.engine!r}: expected inside or service")
        for name in given.keys() - PARAMETERS.keys() - ROS1_NAMES.keys() - {ENGINE, *_OF_RCLPY}:
            if name in TABLE:
                self.settings = with_setting(self.settings, name, given[name].value, name)
            elif not name.startswith("qos_overrides."):
                self.get_logger().warning(f"{name} has no effect: AMCL has no such parameter")

    def _rename_ros1(self) -> None:
        for old, name in ROS1_NAMES.items():
            if self.has_parameter(old) and not self.has_parameter(name):
                self.get_logger().warning(f"{old} of ROS 1 is read as {name}")
                self.declare_parameter(name, self.get_parameter(old).value, _DYNAMIC)

    def _declare(self, name: str, parameter: Parameter) -> None:
        about = ParameterDescriptor(description=parameter.description, dynamic_typing=True)
        if not self.has_parameter(name):
            self.declare_parameter(name, parameter.value(self.settings), about)
            return
        self.set_descriptor(name, about)
        value = self.get_parameter(name).value
        try:
            setting = parameter.converted(value)
        except ValueError as problem:
            raise SettingsError(f"{name} = {value!r}: {problem}") from None
        if type(value) is int and isinstance(parameter.default, float):
            self.set_parameters([RosParameter(name, value=float(value))])
        if parameter.setting and setting is not None:
            self.settings = with_setting(self.settings, parameter.setting, setting, name)
        elif not parameter.setting and value != parameter.default:
            self.get_logger().warning(f"{name} has no effect: {parameter.reason}")
        if isinstance(value, str) and (instead := INSTEAD.get((name, value))):
            self.get_logger().warning(f"{name} = {value} {instead}")

    def _on_set(self, wanted: list[RosParameter]) -> SetParametersResult:
        values = {one.name: one.value for one in wanted if one.name not in _OF_RCLPY}
        if fixed := values.keys() - PARAMETERS.keys():
            reason = f"{', '.join(fixed)}: read only at the start"
        else:
            reason = "" if self._showing or not values else self._port.set_parameters(values)
        return SetParametersResult(successful=not reason, reason=reason)

    def show_parameters(self, values: Mapping[str, Value]) -> None:
        self._showing = True
        self.set_parameters([RosParameter(name, value=value) for name, value in values.items()])
        self._showing = False

    # --- lifecycle

    def _LifecycleNodeMixin__change_state(self, number: int) -> TransitionCallbackReturn:  # noqa: N802
        """Refuse a transition that the state does not allow; rclpy 7.1 raises an error then."""
        try:
            return super()._LifecycleNodeMixin__change_state(number)
        except rclpy_implementation.RCLError as error:
            self.get_logger().warning(str(error))
            return TransitionCallbackReturn.FAILURE

    def on_configure(self, _state: Any) -> TransitionCallbackReturn:
        return self._enter(State.INACTIVE)

    def on_activate(self, _state: Any) -> TransitionCallbackReturn:
        return self._enter(State.ACTIVE)

    def on_deactivate(self, _state: Any) -> TransitionCallbackReturn:
        return self._enter(State.INACTIVE)

    def on_cleanup(self, _state: Any) -> TransitionCallbackReturn:
        return self._enter(State.UNCONFIGURED)

    def on_shutdown(self, _state: Any) -> TransitionCallbackReturn:
        return self._enter(State.FINALIZED)

    def resume(self, before: BridgeState) -> None:
        """Continue in the state of a killed node, with its bond."""
        _log.info("%s again: continuing the state of the killed node", before.state.label)
        self._resumed = before
        self.trigger_configure()
        if before.state is State.ACTIVE:
            self.trigger_activate()
        self._resumed = None

    @property
    def kept_state(self) -> BridgeState:
        bond, held = self._bond.instance_id, self._port.held
        return BridgeState(state=self._port.state, bond=bond, held=held)

    def _enter(self, state: State) -> TransitionCallbackReturn:
        if state is State.ACTIVE and (before := self._resumed):
            self._bond.begin(before.bond)
            self._port.resume(before.held if self.engine == "service" else None)
        else:
            self._port.enter(state)
        return _DONE

    # --- from ROS to the port

    def _receive(self, topic: Topic) -> Callable[[Any], None]:
        if topic != self._names.tf:
            return lambda message: self._port.on_message(topic, message)

        def on_transforms(message: Any) -> None:
            if len(message.transforms) != 1 or _mark(message) not in self._sent:
                self._port.on_message(topic, message)

        return on_transforms

    def _serve(self, name: str) -> Callable[[Any, Any], Any]:
        return lambda request, _response: self._port.call(name, request)

    # --- from the port to ROS

    def _publisher(self, topic: Topic) -> Any:
        return self.create_publisher(class_of(topic.ros_type), topic.name, _qos(topic.qos))

    def publish(self, topic: Topic, message: Any) -> None:
        if topic == self._names.tf:
            self._sent.append(_mark(message))
        self._publishers_of[topic].publish(message)

    def bond(self, *, alive: bool) -> None:
        if alive:
            self._bond.begin()
        else:
            self._bond.end()

    def load_map(self, file: str) -> None:
        kind = class_of("nav2_msgs/srv/LoadMap")
        if self._load_map is None:
            self._load_map = self.create_client(kind, "map_server/load_map")

        def on_done(future: Any) -> None:
            result = future.result()
            failed = result is None or result.result != kind.Response.RESULT_SUCCESS
            self._port.on_map_loaded("map_server refuses it" if failed else "")

        asked = self._load_map.call_async(kind.Request(map_url=file))
        asked.add_done_callback(lambda future: self.later(lambda: on_done(future)))

    def refuse(self, cause: AnyCause, detail: str) -> None:
        self._causes.warn(_log, cause, detail, time.monotonic())

    def refused(self) -> Mapping[str, int]:
        return self._causes.total

    def now_ns(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def monotonic_ns(self) -> int:
        return time.monotonic_ns()

    # --- from the engine, in any thread

    def on_belief(self, belief: Belief) -> None:
        self.later(lambda: self._port.on_belief(belief))

    def on_particles(self, cluster: int, particles: Particles) -> None:
        self.later(lambda: self._port.on_particles(cluster, particles))

    def on_changes(self, changes: Changes) -> None:
        self.later(lambda: self._port.on_changes(changes))

    def on_advice(self, advice: Advice) -> None:
        self.later(lambda: self._port.on_advice(advice))

    def on_status(self, status: EngineStatus | None) -> None:
        self.later(lambda: self._port.on_status(status))

    def on_refused(self, cause: AnyCause, detail: str) -> None:
        self.later(lambda: self.refuse(cause, detail))


_DYNAMIC = ParameterDescriptor(dynamic_typing=True)


def _mark(message: Any) -> tuple[int, int, float, float]:
    one = message.transforms[0]
    stamp, at = one.header.stamp, one.transform.translation
    return stamp.sec, stamp.nanosec, at.x, at.y


def _qos(qos: Qos) -> QoSProfile:
    reliability, durability = QoSReliabilityPolicy, QoSDurabilityPolicy
    return QoSProfile(
        depth=qos.depth,
        reliability=reliability.BEST_EFFORT if qos.best_effort else reliability.RELIABLE,
        durability=durability.TRANSIENT_LOCAL if qos.latched else durability.VOLATILE,
    )
