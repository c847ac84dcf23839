"""A world: the map for the localizer, and the true map in which the robot drives."""

from dataclasses import dataclass

from grid_maps.grid_map import GridMap
from protocol.errors import ClusterMclError
from protocol.message import PoseTuple

Waypoint = tuple[float, float]
"""x [m], y [m] in the map."""


class UnknownWorldError(ClusterMclError):
    """No simulated world has this name."""

    def __init__(self, name: str, *, known: tuple[str, ...]) -> None:
        self.name, self.known = name, known
        super().__init__(f"no simulated world {name!r}; known are {', '.join(known)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """A simulated world.

    Args:
        name: name for the command line.
        summary: one line about what makes it easy or hard.
        map: the map for the localizer.
        truth: the true map; equal to `map` unless the map is outdated.
        start: start pose `map_from_robot`; None: random.
        route: points to drive to first; then the robot wanders.
        lidar_range_m: range of the laser.
    """

    name: str
    summary: str
    map: GridMap
    truth: GridMap
    start: PoseTuple | None = None
    route: tuple[Waypoint, ...] = ()
    lidar_range_m: float = 12.0


def world_from_map(grid_map: GridMap, name: str = "map") -> World:
    """Return a world that equals its map, with a random start and no route."""
    return World(name=name, summary="as its map shows it", map=grid_map, truth=grid_map)
