"""A port between a graph of ROS and an engine that keep what they are given, and beliefs."""

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

from msgspec.structs import replace

from clustermcl.protocol.answers import Belief, State
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.message import Covariance, PoseTuple
from clustermcl.ros2.parameter_table import Value
from clustermcl.ros2.port import Port
from clustermcl.ros2.sides import Command, Reading
from clustermcl.ros2.topics import Topic
from clustermcl.runtime.settings import Settings
from tests.unit.evaluation import places as made

COVARIANCE: Covariance = (0.04, 0.01, 0.0, 0.01, 0.09, 0.0, 0.0, 0.0, 0.02)


def belief(
    stamp_ns: int, *places: tuple[int, float, PoseTuple], state: State = "ambiguous", term: int = 1
) -> Belief:
    """Places are cluster, probability and pose, most probable first."""
    drawn = [
        made.place(probability, mean, cluster=cluster, covariance=COVARIANCE)
        for cluster, probability, mean in places
    ]
    return replace(made.belief(stamp_ns, state, *drawn, term=term), stamp_ns=stamp_ns)


class Publish(NamedTuple):
    topic: Topic
    message: Any


class Refused(NamedTuple):
    cause: str
    detail: str


class Kept:
    """The graph and the engine."""

    def __init__(self) -> None:
        self.log: list[Any] = []
        """All readings, commands, publications and refusals, in their order."""
        self.bonds: list[bool] = []
        self.shown: dict[str, Value] = {}
        self.questions = 0
        self.loads: list[str] = []
        self.ros_ns = self.process_ns = 0
        self.put = self.command = self.log.append
        self.load_map, self.show_parameters = self.loads.append, self.shown.update

    @property
    def readings(self) -> list[Reading]:
        return [one for one in self.log if isinstance(one, Reading)]

    @property
    def commands(self) -> list[Command]:
        return [one for one in self.log if isinstance(one, Command)]

    def on(self, topic: Topic) -> list[Any]:
        return [one.message for one in self.log if isinstance(one, Publish) and one.topic == topic]

    def publish(self, topic: Topic, message: Any) -> None:
        self.log.append(Publish(topic, message))

    def is_heard(self, _topic: Topic) -> bool:
        return True

    def bond(self, *, alive: bool) -> None:
        self.bonds.append(alive)

    def refuse(self, cause: AnyCause, detail: str) -> None:
        assert detail
        self.log.append(Refused(cause, detail))

    def refused(self) -> Mapping[str, int]:
        return Counter(one.cause for one in self.log if isinstance(one, Refused))

    def now_ns(self) -> int:
        return self.ros_ns

    def monotonic_ns(self) -> int:
        return self.process_ns

    def ask_advice(self) -> None:
        self.questions += 1


def port(settings: Settings | None = None) -> tuple[Port, Kept]:
    kept = Kept()
    return Port(settings or Settings(), kept, kept), kept
