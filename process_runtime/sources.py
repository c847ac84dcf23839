"""Where readings come from, as `bridge.source` names it: parsed once, a type from then on."""

from dataclasses import dataclass
from typing import TypeAlias

_LIVE = "zenoh"
SIMULATED = "sim:"
"""Before the name of a world, or the path of a map."""


@dataclass(frozen=True)
class Live:
    """A robot publishes its readings over Zenoh, with stamps of a clock that runs like any."""


@dataclass(frozen=True)
class Recorded:
    """A recording."""

    path: str


@dataclass(frozen=True)
class Simulated:
    """A simulated robot."""

    world: str
    """The name of a world, or the path of a map file."""


def is_published(map_file: str, source: str, *, ros2: bool) -> bool:
    """Whether a robot that publishes its readings also publishes the map.

    Args:
        map_file: ``zenoh``, or empty with ROS: the map comes from ROS's topic.
        source: of the readings.
        ros2: the bridge to ROS is enabled.
    """
    return source == _LIVE and (map_file == _LIVE or (ros2 and not map_file))


NO_MAP = (
    "bridge.map is empty: name the map file by --set bridge.map=FILE; "
    "with ros2.enabled=true it comes from ROS's topic"
)


SourceChoice: TypeAlias = Live | Recorded | Simulated


def parsed_source(text: str) -> SourceChoice:
    """What ``zenoh``, ``sim:WORLD``, ``sim:MAP.yaml`` or a recording's path stands for."""
    if text == _LIVE:
        return Live()
    if text.startswith(SIMULATED):
        return Simulated(text.removeprefix(SIMULATED))
    return Recorded(text)
