"""All worlds by name."""

from robot_simulator.worlds.eight_rooms import eight_rooms
from robot_simulator.worlds.halls import hall, hall_last_year, hall_moved, hall_symmetric
from robot_simulator.worlds.office import office
from robot_simulator.worlds.rooms import cross, cross_feature, cross_tags, gates, rectangle
from robot_simulator.worlds.world import UnknownWorldError, World

_WORLDS = {
    draw.__name__: draw
    for draw in (
        cross, cross_feature, cross_tags, rectangle, gates, office, hall, hall_symmetric,
        hall_moved, hall_last_year, eight_rooms,
    )
}  # fmt: skip


def world_names() -> tuple[str, ...]:
    return tuple(_WORLDS)


def world(name: str) -> World:
    """Return the world of a name.

    Raises:
        UnknownWorldError: there is no world of this name.
    """
    if name not in _WORLDS:
        raise UnknownWorldError(name, known=world_names())
    return _WORLDS[name]()
