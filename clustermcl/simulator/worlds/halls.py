"""Halls of 450 m²: one without symmetry, one with symmetry, and that one between two yards."""

from collections.abc import Sequence
from dataclasses import replace

from clustermcl.simulator.observing import Gnss
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
    return world_from_map(_symmetric_plan(_WIDTH_M + 4.0).grid_map())


def yard() -> World:
    """Return the symmetric hall between two yards, with a receiver of satellite positions.

    The yards look alike, and only there the receiver has fixes. Some are wrong.
    """
    outdoors = ((12.5, -1.2, 13.1, 1.2), (13.1, -6.0, 24.0, 6.0), (24.0, 1.0, 24.8, 3.0))
    containers = ((16.0, 2.5, 19.0, 4.0), (20.5, -4.6, 21.9, -1.6))
    plan = _symmetric_plan(54.0, outdoors, containers)
    return replace(
        world_from_map(plan.grid_map(), start=(2.0, 0.0, 0.0), route=((11.0, 0.0), (18.0, 0.0))),
        sensor=Gnss(sigma_m=3.0, bias_m=(1.0, -0.5), indoors=(-13.1, -9.8, 13.1, 9.8)),
    )


def _symmetric_plan(
    width_m: float,
    rooms: Sequence[tuple[float, ...]] = (),
    blocks: Sequence[tuple[float, ...]] = (),
) -> Canvas:
    """Draw one half of a hall and of what lies east of it, and repeat it rotated."""
    plan, furniture = (Canvas(width_m, _HEIGHT_M + 4.0) for _ in ("walls", "furniture"))
    plan.floor(-12.5, -8.5, 12.5, 8.5)
    for space in (*NICHES[:5], *rooms):
        plan.floor(*space)
    plan.repeat_turned(2)
    plan.add_walls()
    for x, y, side in PILLARS[:5]:
        furniture.block(x, y, x + side, y + side)
    furnish(furniture, (*FURNITURE, *blocks))
    furniture.repeat_turned(2)
    plan.add(furniture)
    return plan


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
