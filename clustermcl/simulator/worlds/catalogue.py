"""All worlds by name."""

from pathlib import Path

from clustermcl.recordings.maps.map_file import load_map_with_obstacles
from clustermcl.runtime.sources import Simulated
from clustermcl.simulator.worlds.halls import hall, hall_symmetric
from clustermcl.simulator.worlds.office import office
from clustermcl.simulator.worlds.rooms import cross, cross_feature, cross_tags
from clustermcl.simulator.worlds.tower import tower
from clustermcl.simulator.worlds.world import UnknownWorldError, World, world_from_map

WORLDS = {
    draw.__name__: draw
    for draw in (cross, cross_feature, cross_tags, office, hall, hall_symmetric, tower)
}


def world(name: str) -> World:
    """Return the world with this name; an `UnknownWorldError` lists all."""
    if name not in WORLDS:
        raise UnknownWorldError(name, known=tuple(WORLDS))
    return WORLDS[name]()


def simulated_world(robot: Simulated) -> World:
    """Return the world that a source names: one of the catalogue, or one made of a map file."""
    name = robot.world
    if name and name not in WORLDS and (Path(name).suffix or Path(name).exists()):
        return world_from_map(load_map_with_obstacles(name))
    return world(name)
