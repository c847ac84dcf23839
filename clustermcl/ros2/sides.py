"""The two sides of the node's decisions: ROS's graph, and the engine that localizes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

from clustermcl.protocol.answers import Configure, Freshness, Relocalize, SetPose, State, Update
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.live_settings import LiveSettings
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.ros2.parameter_table import Value
from clustermcl.ros2.topics import Topic

SENDER = "amcl"
"""Sender of all messages to the engine."""
NO_ID = ""
"""Id of a command; the engine replaces it."""

Command: TypeAlias = SetPose | Relocalize | Update | Configure
Reading: TypeAlias = LaserReading | OdometryReading | Observation | MapReading


class Ros(Protocol):
    """The node in ROS's graph, which carries out what is decided."""

    def publish(self, topic: Topic, message: Any) -> None: ...

    def is_heard(self, topic: Topic) -> bool: ...

    def bond(self, *, alive: bool) -> None:
        """Start or end the heartbeat for nav2's lifecycle manager."""

    def show_parameters(self, values: Mapping[str, Value]) -> None:
        """Set the node's parameters to values that were not set by a call."""

    def load_map(self, file: str) -> None:
        """Have map_server load a map, and call `Port.on_map_loaded` with its answer."""

    def refuse(self, cause: AnyCause, detail: str) -> None:
        """Count something unusable by its cause, and log it in one line."""

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

    state: State
    freshness: Freshness
    step: int
    workers: int
    settings: LiveSettings
