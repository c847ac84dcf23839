"""Symmetric crosses; some have one feature that breaks the symmetry."""

from dataclasses import replace

import numpy as np

from clustermcl.protocol.steps import Landmark
from clustermcl.simulator.sensors import Camera
from clustermcl.simulator.worlds.world import Canvas, Waypoint, World, world_from_map

_CROSS_M = 22.0
_CORRIDOR_M = 1.25
"""Half the width of an arm of the cross."""


def cross() -> World:
    """Return a cross of four equal arms that no scan can distinguish."""
    return world_from_map(_cross_plan().grid_map())


def cross_tags() -> World:
    """Return the cross with tags in its eastern and northern arms; the route passes both."""
    tags = (("east", 7.7, 0.0), ("north", 0.0, 7.7))
    return replace(
        cross(),
        start=(4.0, 0.0, np.pi),
        route=((0.0, 0.0), (0.0, 5.5)),
        landmarks=tuple(Landmark(name=name, x=x, y=y, sigma=0.05) for name, x, y in tags),
        observe=Camera(false_names=0.05).observe,
    )


def cross_feature() -> World:
    """Return the cross with one cabinet, in the chamber at the end of the eastern arm.

    The route first visits the other three arms, but not their chambers. So no scan distinguishes
    the arms until the robot enters the eastern chamber.
    """
    plan = _cross_plan()
    plan.block(8.4, 0.75, 9.8, 1.75)
    middle: Waypoint = (0.0, 0.0)
    inner = [(-4.6, 0.0), middle, (0.0, -4.6), middle]
    chamber = [(5.8, -0.35), (6.9, -0.75), (8.4, -0.6), (9.7, -0.6), (7.7, -0.4), (7.7, 0.9)]
    return world_from_map(
        plan.grid_map(),
        start=(0.0, 4.2, -np.pi / 2),
        route=(middle, *inner, (4.0, 0.0), *chamber),
    )


def _cross_plan() -> Canvas:
    """Draw the eastern arm, and rotate it to the other three."""
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
