"""AMCL's node without ROS, and without the engine that localizes: both are given."""

from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from clustermcl.protocol.answers import Belief, Configure, Relocalize, Update
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.changes import Changes
from clustermcl.recordings.maps.building import floor_files
from clustermcl.ros2 import message_types as types
from clustermcl.ros2 import topics
from clustermcl.ros2.amcl import Amcl
from clustermcl.ros2.floor_maps import FloorMaps
from clustermcl.ros2.message_types import new
from clustermcl.ros2.messages_out import changes_grid, diagnostics
from clustermcl.ros2.parameters import Parameters
from clustermcl.ros2.sides import NO_ID, SENDER, Engine, EngineStatus, Ros
from clustermcl.ros2.topics import Topic, Topics
from clustermcl.runtime.settings import Settings

SERVICES = {
    "reinitialize_global_localization": types.EMPTY,
    "request_nomotion_update": types.EMPTY,
    "set_initial_pose": types.SET_INITIAL_POSE,
    "~/advise": types.EMPTY,
    "~/is_localized": types.TRIGGER,
}
"""The services with their types; names follow ROS's rules."""

_DIAGNOSTICS_EVERY_NS = 1_000_000_000


class State(Enum):
    """The lasting states of a managed node."""

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    ACTIVE = "active"
    FINALIZED = "finalized"


class Port(Amcl):
    """`Amcl` with its lifecycle, services, parameters and diagnostics."""

    def __init__(self, settings: Settings, ros: Ros, engine: Engine, name: str = "amcl") -> None:
        super().__init__(settings.ros2, ros, engine, name)
        self._topics = Topics(settings.ros2)
        self.parameters = Parameters(settings)
        self.state = State.UNCONFIGURED
        self._status: EngineStatus | None = None
        self._diagnostics_ns = 0
        named = settings.bridge.map
        self._floors = FloorMaps(floor_files(Path(named)) if named else {})

    # --- from ROS

    def on_message(self, topic: Topic, message: Any) -> None:
        match topic:
            case topic if topic in self._topics.scans:
                self.on_scan(message)
            case topics.TF | topics.TF_STATIC:
                self.on_transforms(message, fixed=topic == topics.TF_STATIC)
            case self._topics.map if self._floors.files:
                pass  # map_server has the map of one floor, the engine that of the building
            case self._topics.map:
                self.on_map(message)
            case topic if topic in self._topics.observed:
                self.on_observed(message, topic)
            case topics.INITIAL_POSE:
                self.on_initial_pose(message)

    def call(self, service: str, request: Any) -> Any:
        """Return the response to a call of one of `SERVICES`."""
        match service:
            case "reinitialize_global_localization":
                self._engine.command(Relocalize(sender=SENDER, command_id=NO_ID))
            case "request_nomotion_update":
                self._engine.command(Update(sender=SENDER, command_id=NO_ID))
            case "set_initial_pose":
                self.on_initial_pose(request.pose)
            case "~/advise":
                self._engine.ask_advice()
            case "~/is_localized":
                return self._is_localized()
        return new(f"{SERVICES[service]}_Response")

    def enter(self, state: State) -> None:
        """Enter a state of the lifecycle; UNCONFIGURED after another state resets the node."""
        before, self.state = self.state, state
        if state is State.ACTIVE:
            self.activate()
            self._ros.bond(alive=True)
        elif before is State.ACTIVE:
            self.deactivate()
            self._ros.bond(alive=False)
        if state is State.UNCONFIGURED:
            self._reset()

    def resume(self, held: int | None) -> None:
        """Be active in place of a killed node, which published the cluster `held` as the pose."""
        self.state, self.is_active, self.choice.held = State.ACTIVE, True, held
        # Otherwise a standing robot gets no belief.
        self._engine.command(Update(sender=SENDER, command_id=NO_ID))

    def set_parameters(self, values: Mapping[str, object]) -> str:
        """Set all parameters or, if one is invalid, none; return the reason, or an empty text."""
        before = self.parameters.live
        reason = self.parameters.set(values)
        self.use(self.parameters.settings.ros2)
        if self.parameters.live != before:
            self._configure()
        return reason

    def tick(self) -> None:
        """Do what is due; to be called when nothing else is to do, and ten times a second."""
        self.waits_for_map = self._floors.waits(self._ros.monotonic_ns())
        self.use_waiting()
        self.all_places()
        if (now_ns := self._ros.monotonic_ns()) >= self._diagnostics_ns:
            self._diagnostics_ns = now_ns + _DIAGNOSTICS_EVERY_NS
            self._ros.publish(topics.DIAGNOSTICS, self._diagnostics())

    # --- from the engine

    def on_changes(self, changes: Changes) -> None:
        if self.is_active:
            frame = self.settings.global_frame
            self._ros.publish(topics.CHANGES, changes_grid(changes, frame))

    def on_belief(self, belief: Belief) -> None:
        super().on_belief(belief)
        if self.settings.load_floor_maps and self.is_active:
            file = self._floors.on_belief(belief, self._ros.monotonic_ns())
            if file is not None:
                self.waits_for_map = True
                self._ros.load_map(str(file.absolute()))

    def on_map_loaded(self, problem: str) -> None:
        """Take map_server's answer to a request; empty: it has loaded the map."""
        self._floors.on_answer(problem)
        self.waits_for_map = False

    def on_refused(self, cause: AnyCause, detail: str) -> None:
        self._ros.refuse(cause, detail)

    def on_status(self, status: EngineStatus | None) -> None:
        """Take the engine's status, at least once a second; None: it does not answer.

        An engine with other live settings gets those of this node.
        """
        self._status = status
        if status is not None and status.settings != self.parameters.live:
            self._configure()

    # --- helpers

    def _configure(self) -> None:
        self._engine.command(Configure(sender=SENDER, settings=self.parameters.live))

    def _reset(self) -> None:
        """As in nav2, the last pose becomes the initial pose of the next activation."""
        self.clean_up()
        initial = self.last_pose
        if initial is None or not self.settings.set_initial_pose:
            return
        names = ("initial_pose.x", "initial_pose.y", "initial_pose.yaw")
        values = dict(zip(names, initial, strict=True))
        self.parameters.replace(values, self.choice.floor)
        self.use(self.parameters.settings.ros2)
        self._ros.show_parameters(values)

    @property
    def _freshness(self) -> str:
        return "unreachable" if self._status is None else self._status.freshness

    def _is_localized(self) -> Any:
        belief = self.belief
        state, probable = (belief.state, belief.probability) if belief else ("searching", 0.0)
        is_localized = state == "localized" and self._freshness == "fresh"
        words = f"{state}, {self._freshness}, probability {probable:.3f}"
        return new(f"{types.TRIGGER}_Response", success=is_localized, message=words)

    def _diagnostics(self) -> Any:
        status, belief = self._status, self.belief
        values: dict[str, object] = {"life cycle": self.state.value}
        if belief is not None:
            values["places"] = len(belief.hypotheses)
            values["probability"] = f"{belief.probability:.3f}"
            values["probability elsewhere"] = f"{belief.elsewhere_probability:.3f}"
            values["probability off the map"] = f"{belief.off_map_probability:.3f}"
            values |= {f"floor {name}": f"{p:.3f}" for name, p in belief.floors.items()}
        if self.settings.load_floor_maps:
            values["map of floor"] = self._floors.loaded or "none yet"
            values["load_map"] = self._floors.problem or "ok"
        if status is not None:
            values |= {"step": status.step, "workers": status.workers}
        values |= self._ros.refused()
        state = status.state if status is not None else "searching"
        return diagnostics(state, self._freshness, values, self._name, self._ros.now_ns())
