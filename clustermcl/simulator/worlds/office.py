"""A large office: parallel corridors with rooms that look alike."""

import numpy as np

from clustermcl.simulator.worlds.world import Canvas, Waypoint, World, world_from_map

_ROOM_M = (4.8, 5.8)
"""Width along the corridor, and depth [m]."""
_PITCH_M = 5.0
"""Distance between neighbouring doors [m]."""
_CORRIDOR_M = 2.4
_WING_M = _CORRIDOR_M + 2 * _ROOM_M[1] + 0.6
"""Distance between the middles of neighbouring corridors [m]."""
_UNLIKE_SHARE = 0.25
"""Share of the rooms with their own furniture."""


def office(wings: int = 5, rooms: int = 18) -> World:
    """Return an office in which about every fourth room has its own, random furniture.

    Rooms, doors and corridors repeat exactly. Only furniture and the ends of the corridors
    distinguish places. The furniture is the same in each call.
    """
    rng = np.random.default_rng(20)
    half_m = rooms * _PITCH_M / 2
    plan, furniture = (
        Canvas(2 * (half_m + 4.0), wings * _WING_M + 2.0) for _ in ("walls", "furniture")
    )
    top, bottom = (wings - 1) / 2 * _WING_M, -(wings - 1) / 2 * _WING_M
    for side in (-1, 1):  # the corridors that join all wings
        low, high = sorted((side * half_m, side * (half_m + 2.4)))
        plan.floor(low, bottom - 1.2, high, top + 1.2)
    for wing in range(wings):
        y = bottom + wing * _WING_M
        plan.floor(-half_m, y - _CORRIDOR_M / 2, half_m, y + _CORRIDOR_M / 2)
        plan.floor(half_m + 2.4, y - 0.3 * wing - 0.4, half_m + 3.0, y + 0.4)  # window seats
        for room in range(rooms):
            for up in (-1, 1):
                x = -half_m + room * _PITCH_M + 0.1
                _draw_room(plan, furniture, (x, y), up, rng)
    plan.add_walls()
    plan.add(furniture)
    return world_from_map(plan.grid_map())


def _draw_room(
    plan: Canvas, furniture: Canvas, corner: Waypoint, up: int, rng: np.random.Generator
) -> None:
    """Draw a room with its door and furniture, above (`up` 1) or below (-1) the corridor.

    The corner is x of the room's left wall, and y of the corridor's middle [m].
    """
    x, corridor_y = corner
    width, depth = _ROOM_M
    near = _CORRIDOR_M / 2 + 0.2

    def rectangle(
        left: float, from_door: float, right: float, to: float
    ) -> tuple[float, float, float, float]:
        low, high = sorted((corridor_y + up * from_door, corridor_y + up * to))
        return x + left, low, x + right, high

    plan.floor(*rectangle(0.0, near, width, near + depth))
    plan.floor(*rectangle(0.6, near - 0.2, 1.6, near))  # the door
    if rng.random() >= _UNLIKE_SHARE:
        furniture.block(*rectangle(2.4, near + 3.6, 4.0, near + 4.4))  # a desk
        furniture.block(*rectangle(0.0, near + 4.9, 1.2, near + depth))  # a cabinet
        furniture.block(*rectangle(width - 0.4, near, width, near + 1.6))  # a shelf
        return
    for _ in range(rng.integers(1, 5)):
        wide, deep = rng.uniform(0.5, 1.8, size=2)
        left = rng.uniform(0.0, width - wide)
        back = rng.uniform(near + 1.4, near + depth - deep)
        furniture.block(*rectangle(left, back, left + wide, back + deep))
