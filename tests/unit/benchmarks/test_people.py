"""People walk on free ground, and occlude what is behind them."""

from itertools import islice

import numpy as np
import pytest

from benchmarks.people import RADIUS_M, CrowdSimulation, People, to_discs
from grid_maps.grid_map import GridMap
from robot_simulator.free_space import FreeSpace
from robot_simulator.worlds.catalogue import world

ROOM = GridMap(np.pad(np.zeros((80, 120), np.int8), 2, constant_values=1), 0.05, (-0.1, -0.1, 0.0))


def test_people_change_what_is_seen_but_not_where_the_robot_drives() -> None:
    alone, watched = (
        list(islice(CrowdSimulation(world("hall"), 3, people), 300)) for people in (0, 4)
    )
    assert [tick.map_from_robot for tick in alone] == [tick.map_from_robot for tick in watched]
    far, near = (
        np.array([tick.laser.ranges.array() for tick in ticks]) for ticks in (alone, watched)
    )
    shorter = near < far - 0.5
    assert 0.005 < np.mean(shorter) < 0.3


def test_a_person_occludes_the_beams_behind() -> None:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 181)
    people = np.array([[4.0, 1.0], [1.0, 1.0]])  # the second one is behind
    ranges = to_discs(np.array([2.0, 1.0, 0.0]), angles, people)
    assert ranges[90] == pytest.approx(2.0 - RADIUS_M)
    hidden = np.flatnonzero(np.isfinite(ranges))
    np.testing.assert_array_equal(hidden, np.arange(83, 98))  # asin(0.25 / 2) is 7.2 degrees


def test_people_walk_on_free_ground_and_not_into_the_robot() -> None:
    free_space = FreeSpace(ROOM)
    people, robot = People(3, free_space, np.random.default_rng(0)), (3.0, 2.0, 0.0)
    path = []
    for _ in range(300):
        people.walk(robot, 0.1)
        path.append(people.positions)
    walked = np.array(path)
    assert walked.shape == (300, 3, 2)
    assert all(free_space.clearance_m(x, y) >= RADIUS_M for x, y in walked.reshape(-1, 2))
    assert np.hypot(*(walked - robot[:2]).reshape(-1, 2).T).min() >= 0.8
    assert np.ptp(walked, axis=0).min() > 1.0
    assert np.hypot(*np.diff(walked, axis=0).reshape(-1, 2).T).max() < 0.11
