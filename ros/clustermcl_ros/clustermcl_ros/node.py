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

from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.errors import SettingsError
from clustermcl.ros2 import topics
from clustermcl.ros2.bond import BondThread, BridgeState
from clustermcl.ros2.nav2_params import settings_of
from clustermcl.ros2.parameter_table import PARAMETERS, Value
from clustermcl.ros2.port import SERVICES, Port, State
from clustermcl.ros2.sides import Engine
from clustermcl.ros2.topics import Qos, Topic, Topics
from clustermcl.runtime.logs import CauseCounter
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting
from clustermcl.runtime.settings_table import TABLE
from clustermcl_ros.messages import class_of

ENGINE = "engine"
_OF_RCLPY = ("use_sim_time", "start_type_description_service")
_SENT_TRANSFORMS = 200
_LOAD_MAP = "nav2_msgs/srv/LoadMap"
_DONE = TransitionCallbackReturn.SUCCESS

_log = logging.getLogger(__name__)


class AmclNode(LifecycleNode):  # type: ignore[misc] # rclpy is not installed where types are checked
    """The node. `settings` are ours before the parameters; call `begin` with an engine."""

    def __init__(self, settings: Settings) -> None:
        super().__init__("amcl", automatically_declare_parameters_from_overrides=True)
        self.full_name = self.get_fully_qualified_name()
        self.settings = settings
        self.engine = "inside"
        self._declare_parameters()
        self._names = Topics(self.settings.ros2)
        self._publishers_of = {topic: self._publisher(topic) for topic in topics.SENT}
        self._sent: deque[tuple[int, int, float, float]] = deque(maxlen=_SENT_TRANSFORMS)
        """Stamps and positions of our own transforms, which ROS delivers to this node too."""
        self._bond = BondThread(self._publishers_of[topics.BOND].publish, self.get_name())
        self._causes, self._showing = CauseCounter(), False
        self._resumed: BridgeState | None = None
        self._calls: SimpleQueue[Callable[[], object]] = SimpleQueue()
        self._called = self.create_guard_condition(self._run_calls)

    def begin(self, engine: Engine) -> None:
        """Begin to receive; `engine` has a `Relay` to the port."""
        self.port = Port(self.settings, self, engine, self.full_name.strip("/"))
        for topic in self._names.read():
            kind = class_of(topic.ros_type)
            self.create_subscription(kind, topic.name, self._receive(topic), _qos(topic.qos))
        for name, ros_type in SERVICES.items():
            self.create_service(class_of(ros_type), name, self._serve(name))
        if self.settings.ros2.load_floor_maps:
            # Before the first request: DDS loses one that is made before it has found the server.
            self._load_map = self.create_client(class_of(_LOAD_MAP), "map_server/load_map")
        self.add_on_set_parameters_callback(self._on_set)
        backward = JumpThreshold(
            min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False
        )
        self._jumps = self.get_clock().create_jump_callback(
            backward,
            post_callback=lambda jump: self.later(
                lambda: self.port.on_clock_set_back(-jump.delta.nanoseconds)
            ),
        )

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
        """Take the given parameters: `engine`, nav2's, and our settings by their names."""
        given = {name: one.value for name, one in self.get_parameters_by_prefix("").items()}
        for name in (*_OF_RCLPY, *(name for name in given if name.startswith("qos_overrides."))):
            given.pop(name, None)
        self.engine = given.pop(ENGINE, None) or self.declare_parameter(ENGINE, "inside").value
        if self.engine not in ("inside", "service"):
            raise SettingsError(f"{ENGINE} = {self.engine!r}: expected inside or service")
        ours = {name: given.pop(name) for name in given.keys() & TABLE.keys()}
        try:
            values, notes = settings_of(given)
        except ValueError as problem:
            raise SettingsError(str(problem)) from None
        for name, value in (values | ours).items():
            self.settings = with_setting(self.settings, name, value, "ROS parameter")
        for line in notes:
            self.get_logger().warning(line)
        for name, parameter in PARAMETERS.items():
            about = ParameterDescriptor(description=parameter.description, dynamic_typing=True)
            value = parameter.value(self.settings)
            if not self.has_parameter(name):
                self.declare_parameter(name, value, about)
            else:
                self.set_descriptor(name, about)
                if parameter.setting:  # such as 2.0 for 2
                    self.set_parameters([RosParameter(name, value=value)])

    def _on_set(self, wanted: list[RosParameter]) -> SetParametersResult:
        values = {one.name: one.value for one in wanted if one.name not in _OF_RCLPY}
        if fixed := values.keys() - PARAMETERS.keys():
            reason = f"{', '.join(fixed)}: read only at the start"
        else:
            reason = "" if self._showing or not values else self.port.set_parameters(values)
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

    on_deactivate = on_configure

    def on_cleanup(self, _state: Any) -> TransitionCallbackReturn:
        return self._enter(State.UNCONFIGURED)

    def on_shutdown(self, _state: Any) -> TransitionCallbackReturn:
        return self._enter(State.FINALIZED)

    def resume(self, before: BridgeState) -> None:
        """Continue in the state of a killed node, with its bond."""
        _log.info("%s again: continuing the state of the killed node", before.state.value)
        self._resumed = before
        self.trigger_configure()
        if before.state is State.ACTIVE:
            self.trigger_activate()
        self._resumed = None

    @property
    def kept_state(self) -> BridgeState:
        bond, held = self._bond.instance_id, self.port.choice.held
        return BridgeState(state=self.port.state, bond=bond, held=held)

    def _enter(self, state: State) -> TransitionCallbackReturn:
        if state is State.ACTIVE and (before := self._resumed):
            self._bond.begin(before.bond)
            self.port.resume(before.held if self.engine == "service" else None)
        else:
            self.port.enter(state)
        return _DONE

    # --- from ROS to the port

    def _receive(self, topic: Topic) -> Callable[[Any], None]:
        if topic != topics.TF:
            return lambda message: self.port.on_message(topic, message)

        def on_transforms(message: Any) -> None:
            if len(message.transforms) != 1 or _mark(message) not in self._sent:
                self.port.on_message(topic, message)

        return on_transforms

    def _serve(self, name: str) -> Callable[[Any, Any], Any]:
        return lambda request, _response: self.port.call(name, request)

    # --- from the port to ROS

    def _publisher(self, topic: Topic) -> Any:
        return self.create_publisher(class_of(topic.ros_type), topic.name, _qos(topic.qos))

    def publish(self, topic: Topic, message: Any) -> None:
        if topic == topics.TF:
            self._sent.append(_mark(message))
        self._publishers_of[topic].publish(message)

    def is_heard(self, topic: Topic) -> bool:
        return bool(self._publishers_of[topic].get_subscription_count())

    def bond(self, *, alive: bool) -> None:
        if alive:
            self._bond.begin()
        else:
            self._bond.end()

    def load_map(self, file: str) -> None:
        kind = class_of(_LOAD_MAP)

        def on_done(future: Any) -> None:
            result = future.result()
            failed = result is None or result.result != kind.Response.RESULT_SUCCESS
            self.port.on_map_loaded("map_server refuses it" if failed else "")

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


class Relay:
    """Stands for the port in other threads: the executor's thread makes the calls."""

    def __init__(self, node: AmclNode) -> None:
        self._node = node

    def __getattr__(self, method: str) -> Callable[..., None]:
        def call(*arguments: Any) -> None:
            self._node.later(lambda: getattr(self._node.port, method)(*arguments))

        return call


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
