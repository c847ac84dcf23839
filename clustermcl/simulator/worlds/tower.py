"""A tower: three floors, of which two look alike, and a lift."""

from clustermcl.protocol.floors import Link
from clustermcl.recordings.maps.building import atlas_of
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.simulator.worlds.world import Canvas, World, world_from_map

_HALF_M, _ROOM_M, _CORRIDOR_M = 12.0, 4.0, 1.2
LIFT = Link("lift", dict.fromkeys(("ground", "first", "second"), (0.0, 2.4)), radius_m=1.3)
"""A cabin of 2 m x 2 m, whose door leads to the corridor."""


def tower() -> World:
    """Return a building; its robot takes the lift now and then, and begins in the ground floor."""
    floors = {"ground": _ground(), "first": _offices(2), "second": _offices(3)}
    heights_m = {"ground": 0.0, "first": 3.5, "second": 7.0}
    atlas = atlas_of(floors, (LIFT,), heights_m)
    return world_from_map(atlas, start=atlas.floors.in_atlas("ground", (-4.0, 0.0, 0.0)))


def _offices(wide_room: int) -> GridMap:
    """Return an office floor; one of its rooms is deeper, in which alone floors differ."""
    plan = _with_lift()
    plan.floor(-_HALF_M, -_CORRIDOR_M, _HALF_M, _CORRIDOR_M)
    for room in range(6):
        left, deeper = -_HALF_M + room * _ROOM_M, 1.5 if room == wide_room else 0.0
        plan.floor(left + 0.2, -5.5 - deeper, left + _ROOM_M, -_CORRIDOR_M - 0.2)
        plan.floor(left + 1.2, -_CORRIDOR_M - 0.2, left + 2.2, -_CORRIDOR_M)  # the door
        if room not in (2, 3):
            plan.floor(left + 0.2, _CORRIDOR_M + 0.2, left + _ROOM_M, 5.0)
            plan.floor(left + 0.8, _CORRIDOR_M, left + 1.8, _CORRIDOR_M + 0.2)
    plan.add_walls()
    return plan.grid_map()


def _ground() -> GridMap:
    plan, furniture = _with_lift(), Canvas(2 * _HALF_M + 2.0, 16.0)
    plan.floor(-_HALF_M, -7.0, _HALF_M, _CORRIDOR_M)
    plan.add_walls()
    for x in (-8.0, -3.0, 4.5, 9.0):
        furniture.block(x, -3.6, x + 0.6, -3.0)
    furniture.block(-11.0, -6.2, -6.0, -5.4)
    plan.add(furniture)
    return plan.grid_map()


def _with_lift() -> Canvas:
    plan = Canvas(2 * _HALF_M + 2.0, 16.0)
    plan.floor(-1.0, 1.4, 1.0, 3.4)
    plan.floor(-0.5, _CORRIDOR_M, 0.5, 1.4)  # its door
    return plan
