"""The kinds of sources that `bridge.source` can name."""

from dataclasses import dataclass

_LIVE = "zenoh"
SIMULATED = "sim:"
"""Prefix of the name of a world, or of the path of a map."""


@dataclass(frozen=True)
class Live:
    """A robot that publishes its readings over Zenoh, in real time."""


@dataclass(frozen=True)
class Recorded:
    """A recording to play."""

    path: str


@dataclass(frozen=True)
class Simulated:
    """A robot to simulate in a world."""

    world: str


def is_published(map_file: str, source: str) -> bool:
    """Return whether the robot publishes the map: `map_file` is ``zenoh``."""
    return source == map_file == _LIVE


NO_MAP = (
    "bridge.map is empty: name the map file by --set bridge.map=FILE; "
    "if the robot publishes its map, as the ROS node does: --set bridge.map=zenoh"
)
NEED_MAP = "--map is missing: a recording needs the map it was made in"


def parsed_source(text: str) -> Live | Recorded | Simulated:
    """Parse ``zenoh``, ``sim:WORLD``, ``sim:MAP.yaml`` or a recording's path."""
    if text == _LIVE:
        return Live()
    if text.startswith(SIMULATED):
        return Simulated(text.removeprefix(SIMULATED))
    return Recorded(text)
