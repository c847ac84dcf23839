"""The decisions of the bridge, which the process carries out."""

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
    """Start or end the heartbeat for nav2's lifecycle manager."""

    alive: bool


@dataclass(frozen=True)
class GivePose:
    """Give the robot's pose to the coordinator.

    Args:
        map_from_robot: x [m], y [m], heading [rad].
        covariance: of that pose.
        stamp_ns: time of the pose; None: now.
    """

    map_from_robot: PoseTuple
    covariance: Covariance
    stamp_ns: int | None


@dataclass(frozen=True)
class SearchEverywhere:
    """Forget all places and search the whole map."""


@dataclass(frozen=True)
class NoMotionUpdate:
    """Make a step of the next scan although the robot stands."""


@dataclass(frozen=True)
class Reconfigure:
    """Apply these settings from the next step on."""

    settings: LiveSettings


@dataclass(frozen=True)
class GiveMap:
    """Localize in this map."""

    grid_map: GridMap


@dataclass(frozen=True)
class Refused:
    """Something unusable: counted by its cause, and logged in one line."""

    cause: str
    """Name of the counter."""
    detail: str


Reading: TypeAlias = LaserReading | OdometryReading
Output: TypeAlias = (
    Publish
    | Bond
    | Reading
    | GivePose
    | SearchEverywhere
    | NoMotionUpdate
    | Reconfigure
    | GiveMap
    | Refused
)
