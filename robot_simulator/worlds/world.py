"""A world: the map that everybody is given, and the ground the robot really drives on."""

from dataclasses import dataclass

from grid_maps.grid_map import GridMap
from protocol.errors import ClusterMclError
from protocol.message import PoseTuple

Waypoint = tuple[float, float]
"""x [m], y [m] in the map."""


class UnknownWorldError(ClusterMclError):
    """No simulated world has the name that was asked for."""

    def __init__(self, name: str, *, known: tuple[str, ...]) -> None:
        self.name, self.known = name, known
        super().__init__(f"no simulated world {name!r}; known are {', '.join(known)}")


@dataclass(frozen=True, eq=False, kw_only=True)
class World:
    """Where a simulated robot lives.

    Args:
        name: what a person types.
        summary: one line about what makes it easy or hard.
        map: what the localizer is given.
        truth: what is really there; as `map` shows it unless somebody moved furniture.
        start: where the robot starts, `map_from_robot`; None: anywhere it fits.
        route: where it drives first; it wanders at random from the route's end on.
        lidar_range_m: how far the laser sees.
    """

    name: str
    summary: str
    map: GridMap
    truth: GridMap
    start: PoseTuple | None = None
    route: tuple[Waypoint, ...] = ()
    lidar_range_m: float = 12.0


def world_from_map(grid_map: GridMap, name: str = "map") -> World:
    """A world that is exactly as its map says; the robot starts and wanders anywhere."""
    return World(name=name, summary="as its map shows it", map=grid_map, truth=grid_map)
