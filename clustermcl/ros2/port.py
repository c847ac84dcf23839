"""AMCL's node without ROS, and without the engine that localizes: both are given."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from msgspec.structs import replace

from clustermcl.protocol.advice import Advice
from clustermcl.protocol.answers import Belief, Configure, Freshness, Relocalize, Update
from clustermcl.protocol.answers import State as Found
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.changes import Changes
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.protocol.work import Particles
from clustermcl.recordings.maps.building import floor_files
from clustermcl.ros2 import message_types as types
from clustermcl.ros2 import topics
from clustermcl.ros2.amcl import Amcl
from clustermcl.ros2.floor_maps import FloorMaps
from clustermcl.ros2.lifecycle import State
from clustermcl.ros2.message_types import new, response_of
from clustermcl.ros2.messages_out import changes_grid, diagnostics
from clustermcl.ros2.outputs import NO_ID, SENDER, Command, Output, Publish, Reading, Refused
from clustermcl.ros2.parameter_table import Value
from clustermcl.ros2.parameters import Parameters
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


class Ros(Protocol):
    """The node in ROS's graph, which carries out what is decided here."""

    def publish(self, topic: Topic, message: Any) -> None: ...

    def is_heard(self, topic: Topic) -> bool: ...

    def bond(self, *, alive: bool) -> None:
        """Start or end the heartbeat for nav2's lifecycle manager."""

    def show_parameters(self, values: Mapping[str, Value]) -> None:
        """Set the node's parameters to values that were not set by a call."""

    def load_map(self, file: str) -> None:
        """Have map_server load a map, and call `Port.on_map_loaded` with its answer."""

    def refuse(self, cause: AnyCause, detail: str) -> None: ...

    def refused(self) -> Mapping[str, int]: ...

    def now_ns(self) -> int: ...

    def monotonic_ns(self) -> int: ...


class Engine(Protocol):
    """What localizes. It calls `Port`, in the executor's thread."""

    def put(self, reading: Reading) -> None: ...

    def command(self, command: Command) -> None: ...

    def ask_advice(self) -> None: ...


@dataclass(frozen=True)
class EngineStatus:
    """The state of an engine."""

    state: Found
    freshness: Freshness
    step: int
    workers: int
    settings: LiveSettings


class Port:
    """Takes messages, calls and changes of state from ROS, and beliefs from the engine."""

    def __init__(self, settings: Settings, ros: Ros, engine: Engine, name: str = "amcl") -> None:
        self._ros, self._engine, self._name = ros, engine, name
        self._amcl = Amcl(settings.ros2, name)
        self._topics = Topics(settings.ros2)
        self.parameters, self._is_new = Parameters(settings), True
        self.state = State.UNCONFIGURED
        self._status: EngineStatus | None = None
        self._diagnostics_ns = 0
        named = settings.bridge.map
        self._floors = FloorMaps(floor_files(Path(named)) if named else {})

    @property
    def held(self) -> int | None:
        return self._amcl.choice.held

    # --- from ROS

    def on_message(self, topic: Topic, message: Any) -> None:
        amcl, now_ns = self._amcl, self._ros.monotonic_ns()
        match topic:
            case topic if topic in self._topics.scans:
                self._do(amcl.on_scan(message, now_ns))
            case topics.TF:
                self._do(amcl.on_transforms(message, now_ns, fixed=False))
            case topics.TF_STATIC:
                self._do(amcl.on_transforms(message, now_ns, fixed=True))
            case self._topics.map if self._floors.files:
                pass  # map_server has the map of one floor, the engine that of the building
            case self._topics.map:
                self._do(amcl.on_map(message))
            case topic if topic in self._topics.observed:
                self._do(amcl.on_observed(message, topic, now_ns))
            case topics.INITIAL_POSE:
                self._do(amcl.on_initial_pose(message))

    def on_clock_set_back(self, back_ns: int) -> None:
        self._do(self._amcl.on_clock_set_back(back_ns))

    def call(self, service: str, request: Any) -> Any:
        """Return the response to a call of one of `SERVICES`."""
        match service:
            case "reinitialize_global_localization":
                self._engine.command(Relocalize(sender=SENDER, command_id=NO_ID))
            case "request_nomotion_update":
                self._engine.command(Update(sender=SENDER, command_id=NO_ID))
            case "set_initial_pose":
                self._do(self._amcl.on_initial_pose(request.pose))
            case "~/advise":
                self._engine.ask_advice()
            case "~/is_localized":
                return self._is_localized()
        return new(response_of(SERVICES[service]))

    def enter(self, state: State) -> None:
        """Enter a state of the lifecycle; UNCONFIGURED after another state resets the node."""
        before, self.state = self.state, state
        if state is State.ACTIVE:
            self._do(self._amcl.activate())
            self._ros.bond(alive=True)
        elif before is State.ACTIVE:
            self._amcl.deactivate()
            self._ros.bond(alive=False)
        if state is State.UNCONFIGURED:
            self._reset()

    def resume(self, held: int | None) -> None:
        """Be active in place of a killed node, which published the cluster `held` as the pose."""
        self.state = State.ACTIVE
        self._amcl.resume(held)
        # Otherwise a standing robot gets no belief.
        self._engine.command(Update(sender=SENDER, command_id=NO_ID))

    def set_parameters(self, values: Mapping[str, object]) -> str:
        """Set all parameters or, if one is invalid, none; return the reason, or an empty text."""
        before = self.parameters.live
        reason = self.parameters.set(values)
        self._amcl.use(self.parameters.settings.ros2)
        if self.parameters.live != before:
            self._configure()
        return reason

    def tick(self) -> None:
        """Do what is due; to be called when nothing else is to do, and ten times a second."""
        self._amcl.waits_for_map = self._floors.waits(self._ros.monotonic_ns())
        self._do(self._amcl.on_tick(self._ros.monotonic_ns()))
        with_cloud = self._ros.is_heard(topics.PARTICLE_CLOUD)
        self._do(self._amcl.all_places(with_cloud=with_cloud))
        if (now_ns := self._ros.monotonic_ns()) >= self._diagnostics_ns:
            self._diagnostics_ns = now_ns + _DIAGNOSTICS_EVERY_NS
            self._ros.publish(topics.DIAGNOSTICS, self._diagnostics())

    # --- from the engine

    def on_changes(self, changes: Changes) -> None:
        if self.state is State.ACTIVE:
            frame = self._amcl.settings.global_frame
            self._ros.publish(topics.CHANGES, changes_grid(changes, frame))

    def on_belief(self, belief: Belief) -> None:
        self._do(self._amcl.on_belief(belief))
        if self._amcl.settings.load_floor_maps and self.state is State.ACTIVE:
            file = self._floors.on_belief(belief, self._ros.monotonic_ns())
            if file is not None:
                self._amcl.waits_for_map = True
                self._ros.load_map(str(file.absolute()))

    def on_map_loaded(self, problem: str) -> None:
        """Take map_server's answer to a request; empty: it has loaded the map."""
        self._floors.on_answer(problem)
        self._amcl.waits_for_map = False

    def on_particles(self, cluster: int, particles: Particles) -> None:
        self._amcl.on_particles(cluster, particles)

    def on_advice(self, advice: Advice) -> None:
        self._do(self._amcl.on_advice(advice))

    def on_refused(self, cause: AnyCause, detail: str) -> None:
        self._ros.refuse(cause, detail)

    def on_status(self, status: EngineStatus | None) -> None:
        """Take the engine's status, at least once a second; None: it does not answer.

        At the first one, a node whose parameters are unchanged adopts the engine's live settings.
        Otherwise the engine gets the node's.
        """
        self._status = status
        if status is None:
            return
        is_first, self._is_new = self._is_new, False
        if is_first and self.parameters.live == AS_STARTED:
            self._ros.show_parameters(self.parameters.adopt(status.settings))
        elif status.settings != self.parameters.live:
            self._configure()

    # --- helpers

    def _do(self, outputs: Iterable[Output]) -> None:
        for output in outputs:
            match output:
                case Publish(topic=topic, message=message):
                    self._ros.publish(topic, message)
                case Refused(cause=cause, detail=detail):
                    self._ros.refuse(cause, detail)
                case Observation(landmark="") if self._floors.files:
                    self._engine.put(replace(output, floor=self._amcl.choice.floor))
                case LaserReading() | OdometryReading() | Observation() | MapReading():
                    self._engine.put(output)
                case _:
                    self._engine.command(output)

    def _configure(self) -> None:
        self._engine.command(Configure(sender=SENDER, settings=self.parameters.live))

    def _reset(self) -> None:
        """As in nav2, the last pose becomes the initial pose of the next activation."""
        self._amcl.clean_up()
        initial = self._amcl.last_pose
        if initial is None or not self._amcl.settings.set_initial_pose:
            return
        names = ("initial_pose.x", "initial_pose.y", "initial_pose.yaw")
        values = dict(zip(names, initial, strict=True))
        self.parameters.replace(values)
        self._amcl.use(self.parameters.settings.ros2)
        self._ros.show_parameters(values)

    @property
    def _freshness(self) -> str:
        return "unreachable" if self._status is None else self._status.freshness

    def _is_localized(self) -> Any:
        belief = self._amcl.belief
        state, probable = (belief.state, belief.probability) if belief else ("searching", 0.0)
        is_localized = state == "localized" and self._freshness == "fresh"
        words = f"{state}, {self._freshness}, probability {probable:.3f}"
        return new(response_of(types.TRIGGER), success=is_localized, message=words)

    def _diagnostics(self) -> Any:
        status, belief = self._status, self._amcl.belief
        values: dict[str, object] = {"life cycle": self.state.label}
        if belief is not None:
            values["places"] = len(belief.hypotheses)
            values["probability"] = f"{belief.probability:.3f}"
            values["probability elsewhere"] = f"{belief.elsewhere_probability:.3f}"
            values["probability off the map"] = f"{belief.off_map_probability:.3f}"
            values |= {f"floor {name}": f"{p:.3f}" for name, p in belief.floors.items()}
        if self._amcl.settings.load_floor_maps:
            values["map of floor"] = self._floors.loaded or "none yet"
            values["load_map"] = self._floors.problem or "ok"
        if status is not None:
            values |= {"step": status.step, "workers": status.workers}
        values |= self._ros.refused()
        state = status.state if status is not None else "searching"
        return diagnostics(state, self._freshness, values, self._name, self._ros.now_ns())
