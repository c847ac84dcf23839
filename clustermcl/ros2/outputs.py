"""The decisions of the bridge, which the process carries out."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from clustermcl.protocol.answers import Configure, Relocalize, SetPose, Update
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.ros2.topics import Topic

NO_ID = ""
"""Id of a command in an output; the process replaces it."""


@dataclass(frozen=True)
class Publish:
    """A message for ROS."""

    topic: Topic
    message: Any


@dataclass(frozen=True)
class Bond:
    """Start or end the heartbeat for nav2's lifecycle manager."""

    alive: bool


@dataclass(frozen=True)
class Refused:
    """Something unusable: counted by its cause, and logged in one line."""

    cause: AnyCause
    detail: str


@dataclass(frozen=True)
class AskAdvice:
    """Query ways that distinguish the places; `Amcl.on_advice` takes the answer."""


Command: TypeAlias = SetPose | Relocalize | Update | Configure
Reading: TypeAlias = LaserReading | OdometryReading | Observation | MapReading
Output: TypeAlias = Publish | Bond | Refused | AskAdvice | Reading | Command
