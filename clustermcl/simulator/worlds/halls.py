"""Halls of 450 m²: one without symmetry, and one with symmetry."""

from collections.abc import Sequence

from clustermcl.simulator.worlds.world import Canvas, World, world_from_map

_WIDTH_M, _HEIGHT_M = 26.0, 18.0

PILLARS = (
    (-9.0, 4.5, 0.6), (-4.5, 1.0, 0.6), (-3.0, 6.5, 0.8), (0.5, -3.0, 0.6), (2.0, 4.0, 0.5),
    (6.5, 5.5, 0.7), (6.0, -0.5, 0.6), (9.5, -5.0, 0.8), (10.0, 2.5, 0.5), (-10.5, 0.0, 0.5),
)  # fmt: skip
"""Left edge, lower edge and side of each pillar [m]."""
NICHES = (
    (-11.0, 8.5, -8.5, 9.4), (-5.0, 8.5, -4.0, 9.7), (3.0, 8.5, 6.5, 9.2), (10.5, 8.5, 11.3, 9.6),
    (12.5, -6.0, 13.3, -2.0), (12.5, 4.0, 13.6, 5.0), (-13.4, 3.0, -12.5, 6.5),
    (-13.8, -3.0, -12.5, -2.0), (-10.0, -9.3, -9.0, -8.5), (-2.0, -9.7, 3.5, -8.5),
    (7.0, -9.2, 8.0, -8.5),
)  # fmt: skip
FURNITURE = ((-11.5, -7.5, -9.5, -6.7), (-6.0, -7.8, -5.2, -6.2), (-5.2, -3.6, -3.6, -2.8))


def hall() -> World:
    """Return a hall with irregular niches and pillars, where a few scans leave one place."""
    plan = hall_plan()
    furnish(plan, FURNITURE)
    return world_from_map(plan.grid_map())


def hall_symmetric() -> World:
    """Return a hall of the size of `hall` with two-fold rotational symmetry."""
    plan, furniture = (Canvas(_WIDTH_M + 4.0, _HEIGHT_M + 4.0) for _ in ("walls", "furniture"))
    plan.floor(-12.5, -8.5, 12.5, 8.5)
    for niche in NICHES[:5]:
        plan.floor(*niche)
    plan.repeat_turned(2)
    plan.add_walls()
    for x, y, side in PILLARS[:5]:
        furniture.block(x, y, x + side, y + side)
    furnish(furniture, FURNITURE)
    furniture.repeat_turned(2)
    plan.add(furniture)
    return world_from_map(plan.grid_map())


def hall_plan(
    pillars: Sequence[tuple[float, ...]] = PILLARS, niches: Sequence[tuple[float, ...]] = NICHES
) -> Canvas:
    plan = Canvas(_WIDTH_M + 4.0, _HEIGHT_M + 4.0)
    plan.floor(-12.5, -8.5, 12.5, 8.5)
    for niche in niches:
        plan.floor(*niche)
    plan.add_walls()
    for x, y, side in pillars:
        plan.block(x, y, x + side, y + side)
    return plan


def furnish(plan: Canvas, pieces: Sequence[tuple[float, ...]]) -> None:
    for piece in pieces:
        plan.block(*piece)
