"""Robots behind one router: each localizes, by its own readings alone."""

import math
from pathlib import Path

import pytest

from tests.integration.load.programs.many_robots import run_robots, strangers


def assert_each_finds_itself(robots: int, at_most_s: float, folder: Path) -> None:
    heard = run_robots(robots, at_most_s, folder)
    assert len(heard) == robots
    for name, robot in heard.items():
        assert robot.localized_after_s < math.inf, f"{name}: {robot.errors_m[-5:]}"
        # Not all: under load, the subscriber to everything misses some readings.
        assert robot.made_of(robot.laser_stamps_ns) > len(robot.told_stamps_ns) / 2, name
        assert strangers(name, heard) == 0, name
    stamps = [stamp_ns for robot in heard.values() for stamp_ns in robot.laser_stamps_ns]
    assert len(set(stamps)) == len(stamps), "no two readings have one stamp, so they tell whose"


def test_three_robots_localize_and_receive_nothing_of_each_other(short_folder: str) -> None:
    assert_each_finds_itself(3, 90.0, Path(short_folder))


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_twenty_robots_localize_and_receive_nothing_of_each_other(short_folder: str) -> None:
    assert_each_finds_itself(20, 600.0, Path(short_folder))
