"""A port between a graph of ROS and an engine that keep what they are given."""

from collections import Counter
from collections.abc import Mapping
from typing import Any

from clustermcl.protocol.causes import AnyCause
from clustermcl.ros2.outputs import Command, Reading
from clustermcl.ros2.parameter_table import Value
from clustermcl.ros2.port import Port
from clustermcl.ros2.topics import Topic
from clustermcl.runtime.settings import Settings


class Kept:
    """The graph and the engine."""

    def __init__(self) -> None:
        self.published: list[tuple[Topic, Any]] = []
        self.heard: set[Topic] = set()
        self.bonds: list[bool] = []
        self.shown: dict[str, Value] = {}
        self.causes: Counter[str] = Counter()
        self.readings: list[Reading] = []
        self.commands: list[Command] = []
        self.questions = 0
        self.loads: list[str] = []
        self.ros_ns = self.process_ns = 0
        self.put, self.command, self.load_map = (
            kept.append for kept in (self.readings, self.commands, self.loads)
        )
        self.is_heard, self.show_parameters = self.heard.__contains__, self.shown.update

    def on(self, topic: Topic) -> list[Any]:
        return [message for of, message in self.published if of == topic]

    def publish(self, topic: Topic, message: Any) -> None:
        self.published.append((topic, message))

    def bond(self, *, alive: bool) -> None:
        self.bonds.append(alive)

    def refuse(self, cause: AnyCause, detail: str) -> None:
        assert detail
        self.causes[cause] += 1

    def refused(self) -> Mapping[str, int]:
        return self.causes

    def now_ns(self) -> int:
        return self.ros_ns

    def monotonic_ns(self) -> int:
        return self.process_ns

    def ask_advice(self) -> None:
        self.questions += 1


def port(settings: Settings | None = None) -> tuple[Port, Kept]:
    kept = Kept()
    return Port(settings or Settings(), kept, kept), kept
