"""What the bridge wants done: its decisions, to be carried out by the process."""

from dataclasses import dataclass
from typing import Any, TypeAlias

from grid_maps.grid_map import GridMap
from protocol.live_settings import LiveSettings
from protocol.message import Covariance, PoseTuple
from protocol.steps import LaserReading, OdometryReading
from ros2_bridge.topics import Topic


@dataclass(frozen=True)
class Publish:
    """A message for ROS."""

    topic: Topic
    message: Any


@dataclass(frozen=True)
class Bond:
    """Begin or end the sign of life for nav2's lifecycle manager."""

    alive: bool


@dataclass(frozen=True)
class GivePose:
    """Tell the system where the robot is.

    Args:
        map_from_robot: x [m], y [m], heading [rad].
        covariance: how surely.
        stamp_ns: when it was there; None: now.
    """

    map_from_robot: PoseTuple
    covariance: Covariance
    stamp_ns: int | None


@dataclass(frozen=True)
class SearchEverywhere:
    """Have the system forget all places."""


@dataclass(frozen=True)
class LookOnce:
    """Have the system make a step of the next scan, although the robot stands."""


@dataclass(frozen=True)
class Reconfigure:
    """Have the system go by these settings from its next step on."""

    settings: LiveSettings


@dataclass(frozen=True)
class GiveMap:
    """Have the system localize in a map."""

    grid_map: GridMap


@dataclass(frozen=True)
class Refused:
    """Something that cannot be used: counted by its cause, and said in one line."""

    cause: str
    """Fixed words."""
    detail: str


Reading: TypeAlias = LaserReading | OdometryReading
Output: TypeAlias = (
    Publish
    | Bond
    | Reading
    | GivePose
    | SearchEverywhere
    | LookOnce
    | Reconfigure
    | GiveMap
    | Refused
)
