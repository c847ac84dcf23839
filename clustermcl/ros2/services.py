"""All services of the node: AMCL's, and ROS's for lifecycle and parameters."""

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from clustermcl.ros2 import message_types as types
from clustermcl.ros2 import topics
from clustermcl.ros2.lifecycle import TRANSITION_GRAPH, Lifecycle, State, Transition
from clustermcl.ros2.message_types import new, response_of
from clustermcl.ros2.messages_out import header
from clustermcl.ros2.parameter_services import ParameterServices
from clustermcl.ros2.parameter_table import Value
from clustermcl.ros2.port import SERVICES, Port, Ros

_LASTING = (State.UNCONFIGURED, State.INACTIVE, State.ACTIVE, State.FINALIZED)


class Services:
    """Answers service calls; owns the lifecycle. `node` is the full name of the node."""

    def __init__(self, port: Port, ros: Ros, node: str) -> None:
        self.lifecycle = Lifecycle()
        self._port, self._ros, self._node = port, ros, node
        self._parameters = parameters = ParameterServices(port)
        self._served: dict[str, tuple[str, Callable[[Any], Any]]] = {
            **{name: (kind, self._forward(name)) for name, kind in SERVICES.items()},
            "~/change_state": (types.CHANGE_STATE, self._change_state),
            "~/get_state": (types.GET_STATE, self._get_state),
            "~/get_available_states": (types.GET_AVAILABLE_STATES, self._get_states),
            "~/get_available_transitions": (
                types.GET_AVAILABLE_TRANSITIONS,
                lambda _request: _transitions(self.lifecycle.available()),
            ),
            "~/get_transition_graph": (
                types.GET_AVAILABLE_TRANSITIONS,
                lambda _request: _transitions(TRANSITION_GRAPH),
            ),
            "~/get_parameters": (types.GET_PARAMETERS, parameters.get),
            "~/get_parameter_types": (types.GET_PARAMETER_TYPES, parameters.kinds),
            "~/list_parameters": (types.LIST_PARAMETERS, parameters.names),
            "~/describe_parameters": (types.DESCRIBE_PARAMETERS, parameters.describe),
            "~/set_parameters": (types.SET_PARAMETERS, self._setting(parameters.set)),
            "~/set_parameters_atomically": (
                types.SET_PARAMETERS_ATOMICALLY,
                self._setting(parameters.set_atomically),
            ),
        }

    def types(self) -> dict[str, str]:
        """Return the type of each service by its name, which follows ROS's rules."""
        return {name: ros_type for name, (ros_type, _) in self._served.items()}

    def call(self, service: str, request: Any) -> Any:
        """Return the response to a call."""
        return self._served[service][1](request)

    def change(self, number: int, label: str = "") -> bool:
        """Make a transition of the lifecycle; return whether the state allows it."""
        steps = self.lifecycle.change(number, label)
        for step in steps:
            event = new(types.TRANSITION_EVENT, timestamp=self._ros.now_ns(), **_described(step))
            self._ros.publish(topics.TRANSITION_EVENT, event)
            if step.goal in _LASTING:
                self._port.enter(step.goal)
        return bool(steps)

    def show(self, values: Mapping[str, Value]) -> None:
        """Publish that parameters have changed."""
        self._changed(self._parameters.present(list(values)))

    def _changed(self, taken: list[Any]) -> None:
        if taken:
            stamp, changed = header(self._ros.now_ns(), "").stamp, {"changed_parameters": taken}
            event = new(types.PARAMETER_EVENT, stamp=stamp, node=self._node, **changed)
            self._ros.publish(topics.PARAMETER_EVENTS, event)

    def _forward(self, service: str) -> Callable[[Any], Any]:
        return lambda request: self._port.call(service, request)

    def _change_state(self, request: Any) -> Any:
        success = self.change(request.transition.id, request.transition.label)
        return new(response_of(types.CHANGE_STATE), success=success)

    def _get_state(self, _request: Any) -> Any:
        return new(response_of(types.GET_STATE), current_state=_state(self.lifecycle.state))

    def _get_states(self, _request: Any) -> Any:
        states = [_state(state) for state in State]
        return new(response_of(types.GET_AVAILABLE_STATES), available_states=states)

    def _setting(self, change: Callable[[Any], tuple[Any, list[Any]]]) -> Callable[[Any], Any]:
        """Return a handler of calls that set parameters; `change` also returns those it has set."""

        def handle(request: Any) -> Any:
            response, taken = change(request)
            self._changed(taken)
            return response

        return handle


def _state(state: State) -> Any:
    return new("lifecycle_msgs/msg/State", id=state.value, label=state.label)


def _described(step: Transition) -> dict[str, Any]:
    return {
        "transition": new("lifecycle_msgs/msg/Transition", id=step.number, label=step.label),
        "start_state": _state(step.start),
        "goal_state": _state(step.goal),
    }


def _transitions(steps: Iterable[Transition]) -> Any:
    kind = "lifecycle_msgs/msg/TransitionDescription"
    described = [new(kind, **_described(step)) for step in steps]
    return new(response_of(types.GET_AVAILABLE_TRANSITIONS), available_transitions=described)
