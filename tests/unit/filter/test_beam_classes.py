import math

import numpy as np
import pytest

from clustermcl.filter.arrays import OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.beam_classes import beam_classes
from clustermcl.filter.laser.off_map import BeamClasses
from clustermcl.filter.laser.ray_casting import jump_field
from clustermcl.filter.laser.sensor_model import Beams

CELL_M = 0.05
MIDDLE = np.array([5.0, 5.0, 0.0])
"""Of a room of 10 m; the wall ahead begins 4.95 m away."""
AHEAD_M = 4.975


def room() -> Cells:
    cells = np.zeros((200, 200), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    return cells


def seen(cells: Cells, *ranges: float) -> BeamClasses:
    beams = Beams(np.array(ranges), np.zeros(len(ranges)), np.zeros(3), 30.0)
    return beam_classes(MIDDLE, beams, Grid(cells, CELL_M, np.zeros(3)), jump_field(cells))


@pytest.mark.parametrize(
    ("range_m", "expected"),
    [
        (AHEAD_M, BeamClasses(1, 0, 0, 0)),
        (AHEAD_M - 0.1, BeamClasses(1, 0, 0, 0)),
        (AHEAD_M - 0.2, BeamClasses(0, 1, 0, 0)),
        (AHEAD_M - 0.5, BeamClasses(0, 0, 0, 1)),
        (AHEAD_M + 0.2, BeamClasses(0, 1, 0, 0)),
        (AHEAD_M + 0.6, BeamClasses(0, 0, 1, 0)),
        (30.0, BeamClasses(0, 0, 0, 0)),
    ],
)
def test_a_beam_that_ends_on_near_before_or_behind_a_wall_is_counted_so(
    range_m: float, expected: BeamClasses
) -> None:
    assert seen(room(), range_m) == expected


def test_a_beam_that_ends_at_an_obstacle_behind_a_wall_went_through_the_wall() -> None:
    cells = room()
    cells[:, 150] = OCCUPIED
    assert seen(cells, AHEAD_M, 2.525) == BeamClasses(1, 0, 1, 0)


def test_a_beam_that_ends_just_before_a_close_wall_may_have_met_a_person() -> None:
    cells = room()
    cells[:, 130] = OCCUPIED
    assert seen(cells, 1.3, 1.525, 1.7) == BeamClasses(1, 1, 0, 1), "before it, on it, behind it"


def test_beams_beyond_unknown_ground_have_no_class() -> None:
    cells = room()
    cells[:, 140:145] = UNKNOWN
    assert seen(cells, AHEAD_M, 1.0, AHEAD_M + 2.0) == BeamClasses(0, 0, 0, 3)
    behind = room()
    behind[:, 199] = UNKNOWN
    assert seen(behind, AHEAD_M + 1.0) == BeamClasses(0, 0, 0, 1), "the world goes on off the map"


def test_all_lasers_count_wherever_the_map_lies() -> None:
    back = Beams(np.array([4.6]), np.zeros(1), np.array([-0.4, 0.0, math.pi]), 30.0)
    both = Beams(np.array([AHEAD_M]), np.zeros(1), np.zeros(3), 30.0, others=(back,))
    grid = Grid(room(), CELL_M, np.array([3.0, -2.0, 0.0]))
    pose = MIDDLE + np.array([3.0, -2.0, 0.0])
    assert beam_classes(pose, both, grid, jump_field(room())) == BeamClasses(2, 0, 0, 0)
