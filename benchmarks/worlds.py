"""Worlds of the experiments: symmetric ones, and halls with an outdated map."""

from clustermcl.runtime.sources import Simulated
from clustermcl.simulator.worlds.catalogue import simulated_world
from clustermcl.simulator.worlds.halls import FURNITURE, NICHES, PILLARS, furnish, hall, hall_plan
from clustermcl.simulator.worlds.world import Canvas, World, world_from_map

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


def rectangle() -> World:
    """Return a room whose two ends no scan can distinguish."""
    plan = Canvas(16.0, 10.0)
    plan.floor(-6.5, -3.5, 6.5, 3.5)
    plan.floor(6.5, 0.8, 7.1, 2.0)  # a niche
    plan.floor(1.0, 3.5, 3.5, 4.1)  # a window bay
    plan.repeat_turned(2)
    plan.add_walls()
    furniture = Canvas(16.0, 10.0)
    furniture.block(-4.2, -0.2, -3.8, 0.2)  # a pillar
    furniture.block(-6.5, -3.5, -5.3, -2.9)  # a shelf
    furniture.block(-1.6, -2.0, 0.2, -1.2)  # a table
    furniture.repeat_turned(2)
    plan.add(furniture)
    return world_from_map(plan.grid_map())


def gates() -> World:
    """Return the paper's room: two opposite doors, two benches, cabinets in three corners.

    Each corner is a recess behind a wall that hides its cabinet from the middle of the room. The
    route passes both doors and both corridors. It ends in the north-eastern recess, where the
    cabinet is missing; the opposite recess is never seen.
    """
    plan, furniture = Canvas(22.0, 10.0), Canvas(22.0, 10.0)
    plan.floor(-7.0, -4.0, 7.0, 4.0)
    plan.floor(7.0, -0.6, 7.3, 0.6)  # the eastern door
    plan.floor(7.3, -4.0, 9.5, 4.0)  # the corridor behind it
    plan.floor(9.5, 1.0, 10.0, 2.2)  # a niche in the corridor
    plan.repeat_turned(2)
    plan.add_walls()
    for outwards in (-1, 1):  # recesses in the eastern corners
        for x_min, near, x_max, far in (
            (4.4, 1.9, 7.0, 2.0),
            (4.4, 2.0, 4.5, 2.9),
            (5.7, 2.0, 7.0, 2.7),  # the cabinet
        ):
            low, high = sorted((outwards * near, outwards * far))
            furniture.block(x_min, low, x_max, high)
    furniture.block(-0.3, 1.4, 2.1, 1.9)  # a bench
    furniture.repeat_turned(2)
    plan.add(furniture)
    plan.floor(5.7, 2.0, 7.0, 2.7)  # the cabinet that is missing
    return world_from_map(
        plan.grid_map(),
        start=(-1.0, 0.0, 0.0),
        route=(
            (7.1, 0.0),
            (8.4, -0.2),
            (8.4, -3.0),
            (8.4, 3.0),
            (8.4, 0.0),
            (0.0, 0.0),
            (-7.1, 0.0),
            (-8.4, 0.2),
            (-8.4, 2.8),
            (-8.4, 0.0),
            (-3.0, 0.0),
            (3.2, 0.0),
            (3.2, 2.4),
            (3.6, 3.45),
            (5.2, 3.4),
        ),
    )


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


WORLDS = {draw.__name__: draw for draw in (rectangle, gates, hall_moved, hall_last_year)}


def world(name: str) -> World:
    """Return one of these worlds, one of the simulator, or one made of a map file."""
    return WORLDS[name]() if name in WORLDS else simulated_world(Simulated(name))
