"""Symmetric crosses and rooms; some have one feature that breaks the symmetry."""

from dataclasses import replace

import numpy as np

from protocol.steps import Landmark
from robot_simulator.observing import Camera
from robot_simulator.worlds.world import Canvas, Waypoint, World, world_from_map

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
        sensor=Camera(false_names=0.05),
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
