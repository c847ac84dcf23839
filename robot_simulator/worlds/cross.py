"""A cross with four-fold symmetry, and one with a single distinguishing feature."""

import numpy as np

from robot_simulator.worlds.canvas import Canvas
from robot_simulator.worlds.world import Waypoint, World

_CROSS_M = 22.0
_CORRIDOR_M = 1.25
"""Half the width of an arm."""


def cross() -> World:
    """Four equal arms that no scan can distinguish."""
    plan = _cross_plan().grid_map()
    return World(
        name="cross",
        summary="a cross, four-fold symmetric to the last cell: four places stay equally probable",
        map=plan,
        truth=plan,
    )


def cross_feature() -> World:
    """The cross with one cabinet in the chamber at the end of the eastern arm.

    The route visits three arms without seeing their chambers, not even that they have no cabinet;
    then it enters the eastern chamber.
    """
    plan = _cross_plan()
    plan.block(8.4, 0.75, 9.8, 1.75)
    middle: Waypoint = (0.0, 0.0)
    inner = [(-4.6, 0.0), middle, (0.0, -4.6), middle]
    chamber = [(5.8, -0.35), (6.9, -0.75), (8.4, -0.6), (9.7, -0.6), (7.7, -0.4), (7.7, 0.9)]
    return World(
        name="cross_feature",
        summary="the cross with one cabinet at the end of one arm, seen after 27 m of driving",
        map=plan.grid_map(),
        truth=plan.grid_map(),
        start=(0.0, 4.2, -np.pi / 2),
        route=(middle, *inner, (4.0, 0.0), *chamber),
    )


def _cross_plan() -> Canvas:
    """Draw the eastern arm and rotate it three times."""
    plan = Canvas(_CROSS_M, _CROSS_M)
    plan.floor(0.0, -_CORRIDOR_M, 7.0, _CORRIDOR_M)
    plan.floor(2.6, _CORRIDOR_M, 3.6, 1.9)  # a niche on the left
    plan.floor(4.6, -1.6, 5.4, -_CORRIDOR_M)  # and one on the right
    plan.floor(7.0, -1.75, 10.4, 1.75)  # the chamber
    plan.repeat_turned(4)
    plan.add_walls()
    furniture = Canvas(_CROSS_M, _CROSS_M)
    furniture.block(5.9, 0.95, 6.2, _CORRIDOR_M)  # a pillar
    furniture.block(6.85, -0.25, 7.0, _CORRIDOR_M)  # leaves a door, 1 m wide, into the chamber
    furniture.block(9.8, -1.75, 10.4, -1.25)
    furniture.repeat_turned(4)
    plan.add(furniture)
    return plan
