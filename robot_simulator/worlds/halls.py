"""Halls of 450 m²: one without symmetry, one with symmetry, and two with an outdated map."""

from collections.abc import Sequence

from robot_simulator.worlds.world import Canvas, World, world_from_map

_WIDTH_M, _HEIGHT_M = 26.0, 18.0
_START = (-8.0, -4.5, 0.0)

_PILLARS = (
    (-9.0, 4.5, 0.6), (-4.5, 1.0, 0.6), (-3.0, 6.5, 0.8), (0.5, -3.0, 0.6), (2.0, 4.0, 0.5),
    (6.5, 5.5, 0.7), (6.0, -0.5, 0.6), (9.5, -5.0, 0.8), (10.0, 2.5, 0.5), (-10.5, 0.0, 0.5),
)  # fmt: skip
"""Left edge, lower edge and side of each pillar [m]."""
_NICHES = (
    (-11.0, 8.5, -8.5, 9.4), (-5.0, 8.5, -4.0, 9.7), (3.0, 8.5, 6.5, 9.2), (10.5, 8.5, 11.3, 9.6),
    (12.5, -6.0, 13.3, -2.0), (12.5, 4.0, 13.6, 5.0), (-13.4, 3.0, -12.5, 6.5),
    (-13.8, -3.0, -12.5, -2.0), (-10.0, -9.3, -9.0, -8.5), (-2.0, -9.7, 3.5, -8.5),
    (7.0, -9.2, 8.0, -8.5),
)  # fmt: skip
_FURNITURE = ((-11.5, -7.5, -9.5, -6.7), (-6.0, -7.8, -5.2, -6.2), (-5.2, -3.6, -3.6, -2.8))
"""Furniture around the start, according to the map."""
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


def hall() -> World:
    """Return a hall with irregular niches and pillars, where a few scans leave one place."""
    plan = _hall_plan()
    _furnish(plan, _FURNITURE)
    return world_from_map(plan.grid_map())


def hall_moved() -> World:
    """Return the hall with the furniture moved around the robot's start."""
    mapped, real = _hall_plan(), _hall_plan()
    _furnish(mapped, _FURNITURE)
    _furnish(real, _MOVED_FURNITURE)
    return World(map=mapped.grid_map(), truth=real.grid_map(), start=_START)


def hall_last_year() -> World:
    """Return the hall with last year's map, before 10 % of the walls were moved."""
    old = _hall_plan(
        tuple(_REBUILT.get(pillar, pillar) for pillar in _PILLARS),
        tuple(_REBUILT.get(niche, niche) for niche in _NICHES),
    )
    _furnish(old, _FURNITURE)
    return World(map=old.grid_map(), truth=hall().truth)


def hall_symmetric() -> World:
    """Return a hall of the size of `hall` with two-fold rotational symmetry."""
    plan = Canvas(_WIDTH_M + 4.0, _HEIGHT_M + 4.0)
    plan.floor(-12.5, -8.5, 12.5, 8.5)
    for niche in _NICHES[:5]:
        plan.floor(*niche)
    plan.repeat_turned(2)
    plan.add_walls()
    furniture = Canvas(_WIDTH_M + 4.0, _HEIGHT_M + 4.0)
    for x, y, side in _PILLARS[:5]:
        furniture.block(x, y, x + side, y + side)
    _furnish(furniture, _FURNITURE)
    furniture.repeat_turned(2)
    plan.add(furniture)
    return world_from_map(plan.grid_map())


def _hall_plan(
    pillars: Sequence[tuple[float, ...]] = _PILLARS, niches: Sequence[tuple[float, ...]] = _NICHES
) -> Canvas:
    plan = Canvas(_WIDTH_M + 4.0, _HEIGHT_M + 4.0)
    plan.floor(-12.5, -8.5, 12.5, 8.5)
    for niche in niches:
        plan.floor(*niche)
    plan.add_walls()
    for x, y, side in pillars:
        plan.block(x, y, x + side, y + side)
    return plan


def _furnish(plan: Canvas, pieces: Sequence[tuple[float, ...]]) -> None:
    for piece in pieces:
        plan.block(*piece)
