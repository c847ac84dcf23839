"""The services of AMCL's node. No network."""

from collections.abc import Callable, Iterable
from typing import Any

from clustermcl.protocol.answers import Configure, Relocalize, Update
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.ros2 import message_types as types
from clustermcl.ros2 import topics
from clustermcl.ros2.amcl import Amcl
from clustermcl.ros2.lifecycle import TRANSITION_GRAPH, Lifecycle, State, Transition
from clustermcl.ros2.message_types import new, response_of
from clustermcl.ros2.messages_out import header
from clustermcl.ros2.outputs import NO_ID, AskAdvice, Bond, Output, Publish
from clustermcl.ros2.parameters import Parameters
from clustermcl.runtime.settings import Settings

Answer = tuple[Any, list[Output]]


class Services:
    """Answers service calls; owns the lifecycle and the parameters.

    The clock returns ROS's time [ns]; `node` is the full name of the node.
    """

    def __init__(self, amcl: Amcl, settings: Settings, clock: Callable[[], int], node: str) -> None:
        self.lifecycle = Lifecycle()
        self._amcl, self._clock, self._node = amcl, clock, node
        self._parameters, self._is_new = Parameters(settings), True
        parameters, self._sender = self._parameters, settings.ros2.node_name
        search = Relocalize(sender=self._sender, command_id=NO_ID)
        self.no_motion_update = Update(sender=self._sender, command_id=NO_ID)
        """Makes a step of the next scan although the robot stands."""
        self.freshness = "unreachable"
        self._served: dict[str, tuple[str, Callable[[Any], Answer]]] = {
            "reinitialize_global_localization": (types.EMPTY, _empty(search)),
            "request_nomotion_update": (types.EMPTY, _empty(self.no_motion_update)),
            "~/advise": (types.EMPTY, _empty(AskAdvice())),
            "set_initial_pose": (types.SET_INITIAL_POSE, self._set_initial_pose),
            "~/is_localized": (types.TRIGGER, self._is_localized),
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
            "~/get_parameters": (types.GET_PARAMETERS, _only(parameters.get)),
            "~/get_parameter_types": (types.GET_PARAMETER_TYPES, _only(parameters.kinds)),
            "~/list_parameters": (types.LIST_PARAMETERS, _only(parameters.names)),
            "~/describe_parameters": (types.DESCRIBE_PARAMETERS, _only(parameters.describe)),
            "~/set_parameters": (types.SET_PARAMETERS, self._setting(parameters.set)),
            "~/set_parameters_atomically": (
                types.SET_PARAMETERS_ATOMICALLY,
                self._setting(parameters.set_atomically),
            ),
        }

    def types(self) -> dict[str, str]:
        """Return the type of each service by its name, which follows ROS's rules."""
        return {name: ros_type for name, (ros_type, _) in self._served.items()}

    def call(self, service: str, request: Any) -> Answer:
        """Answer a call; carry out the outputs after sending the response."""
        return self._served[service][1](request)

    def change(self, number: int, label: str = "") -> list[Output]:
        """Make a transition of the lifecycle; no outputs if the state does not allow it."""
        outputs: list[Output] = []
        for step in self.lifecycle.change(number, label):
            event = new(types.TRANSITION_EVENT, timestamp=self._clock(), **_described(step))
            outputs.append(Publish(topics.TRANSITION_EVENT, event))
            match step.start, step.goal:
                case State.ACTIVATING, State.ACTIVE:
                    outputs += [*self._amcl.activate(), Bond(alive=True)]
                case State.ACTIVE, _:
                    self._amcl.deactivate()
                    outputs.append(Bond(alive=False))
                case State.CLEANINGUP, State.UNCONFIGURED:
                    outputs += self._clean_up()
        return outputs

    def _clean_up(self) -> list[Output]:
        """Reset; as in nav2, the last pose becomes the initial pose of the next activation."""
        self._amcl.clean_up()
        initial = self._amcl.last_pose
        if initial is None or not self._amcl.settings.set_initial_pose:
            return []
        names = ("initial_pose.x", "initial_pose.y", "initial_pose.yaw")
        return self._use(self._parameters.replace(dict(zip(names, initial, strict=True))))

    def _change_state(self, request: Any) -> Answer:
        outputs = self.change(request.transition.id, request.transition.label)
        return new(response_of(types.CHANGE_STATE), success=bool(outputs)), outputs

    def _get_state(self, _request: Any) -> Answer:
        return new(response_of(types.GET_STATE), current_state=_state(self.lifecycle.state)), []

    def _get_states(self, _request: Any) -> Answer:
        states = [_state(state) for state in State]
        return new(response_of(types.GET_AVAILABLE_STATES), available_states=states), []

    def _set_initial_pose(self, request: Any) -> Answer:
        outputs = list(self._amcl.on_initial_pose(request.pose))
        return new(response_of(types.SET_INITIAL_POSE)), outputs

    def _setting(self, change: Callable[[Any], tuple[Any, list[Any]]]) -> Callable[[Any], Answer]:
        """Return a handler of calls that set parameters; `change` also returns those it has set."""

        def handle(request: Any) -> Answer:
            before = self._parameters.live
            response, taken = change(request)
            outputs, live = self._use(taken), self._parameters.live
            if live != before:
                outputs.append(Configure(sender=self._sender, settings=live))
            return response, outputs

        return handle

    def on_live_settings(self, found: LiveSettings) -> list[Output]:
        """Reconcile the node's parameters with the system's live settings.

        At the first call, a node whose parameters are unchanged adopts the system's. Otherwise
        return a command that sets the system's to the node's.
        """
        wanted, is_first, self._is_new = self._parameters.live, self._is_new, False
        if found == wanted:
            return []
        if is_first and wanted == AS_STARTED:
            self._parameters.adopt(found)
            return []
        return [Configure(sender=self._sender, settings=wanted)]

    def _use(self, taken: list[Any]) -> list[Output]:
        if not taken:
            return []
        self._amcl.use(self._parameters.settings.ros2)
        stamp, changed = header(self._clock(), "").stamp, {"changed_parameters": taken}
        event = new(types.PARAMETER_EVENT, stamp=stamp, node=self._node, **changed)
        return [Publish(topics.PARAMETER_EVENTS, event)]

    def _is_localized(self, _request: Any) -> Answer:
        belief = self._amcl.belief
        state = belief.state if belief is not None else "searching"
        probable = belief.probability if belief is not None else 0.0
        is_localized = state == "localized" and self.freshness == "fresh"
        words = f"{state}, {self.freshness}, probability {probable:.3f}"
        return new(response_of(types.TRIGGER), success=is_localized, message=words), []


def _empty(output: Output) -> Callable[[Any], Answer]:
    return lambda _request: (new(response_of(types.EMPTY)), [output])


def _only(respond: Callable[[Any], Any]) -> Callable[[Any], Answer]:
    return lambda request: (respond(request), [])


def _state(state: State) -> Any:
    return new("lifecycle_msgs/msg/State", id=state.value, label=state.label)


def _described(step: Transition) -> dict[str, Any]:
    return {
        "transition": new("lifecycle_msgs/msg/Transition", id=step.number, label=step.label),
        "start_state": _state(step.start),
        "goal_state": _state(step.goal),
    }


def _transitions(steps: Iterable[Transition]) -> Answer:
    kind = "lifecycle_msgs/msg/TransitionDescription"
    described = [new(kind, **_described(step)) for step in steps]
    return new(response_of(types.GET_AVAILABLE_TRANSITIONS), available_transitions=described), []
