"""The decisions of AMCL's node, which `Port` passes on."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from clustermcl.protocol.answers import Configure, Relocalize, SetPose, Update
from clustermcl.protocol.causes import AnyCause
from clustermcl.protocol.steps import LaserReading, MapReading, Observation, OdometryReading
from clustermcl.ros2.topics import Topic

SENDER = "amcl"
"""Sender of all messages to the engine."""
NO_ID = ""
"""Id of a command in an output; the process replaces it."""


@dataclass(frozen=True)
class Publish:
    """A message for ROS."""

    topic: Topic
    message: Any


@dataclass(frozen=True)
class Refused:
    """Something unusable: counted by its cause, and logged in one line."""

    cause: AnyCause
    detail: str


Command: TypeAlias = SetPose | Relocalize | Update | Configure
Reading: TypeAlias = LaserReading | OdometryReading | Observation | MapReading
Output: TypeAlias = Publish | Refused | Reading | Command
