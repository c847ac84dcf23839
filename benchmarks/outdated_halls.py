"""Halls with an outdated map: the furniture was moved, or a tenth of the walls."""

from robot_simulator.worlds.catalogue import world as known_world
from robot_simulator.worlds.halls import FURNITURE, NICHES, PILLARS, furnish, hall, hall_plan
from robot_simulator.worlds.world import World

_START = (-8.0, -4.5, 0.0)
_MOVED_FURNITURE = (
    (-11.8, -6.0, -11.0, -4.0), (-7.8, -7.9, -5.8, -7.1), (-5.0, -5.6, -4.2, -4.0),
    (-8.6, -2.8, -7.4, -2.0), (-2.9, -7.0, -2.1, -6.2),
)  # fmt: skip
"""Actual furniture around the start."""
_REBUILT = {
    (-4.5, 1.0, 0.6): (-6.6, 2.4, 0.6),
    (6.0, -0.5, 0.6): (4.0, -1.6, 0.6),
    (3.0, 8.5, 6.5, 9.2): (-1.5, 8.5, 1.5, 9.2),
    (12.5, -6.0, 13.3, -2.0): (12.5, -6.0, 13.3, -4.0),
}
"""Moved pillars and niches: positions in last year's map, by true positions."""


def hall_moved() -> World:
    """Return the hall with the furniture moved around the robot's start."""
    real = hall_plan()
    furnish(real, _MOVED_FURNITURE)
    return World(map=hall().map, truth=real.grid_map(), start=_START)


def hall_last_year() -> World:
    """Return the hall with last year's map, before 10 % of the walls were moved."""
    old = hall_plan(
        tuple(_REBUILT.get(pillar, pillar) for pillar in PILLARS),
        tuple(_REBUILT.get(niche, niche) for niche in NICHES),
    )
    furnish(old, FURNITURE)
    return World(map=old.grid_map(), truth=hall().truth)


OUTDATED = {"hall_moved": hall_moved, "hall_last_year": hall_last_year}


def world(name: str) -> World:
    """Return one of these halls, or a world of the simulator."""
    return OUTDATED[name]() if name in OUTDATED else known_world(name)
