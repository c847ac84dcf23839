"""A laser that sees four posts of its own robot, 20 of 360 beams each."""

import math
from collections.abc import Iterator
from itertools import islice

import pytest
from msgspec.structs import replace

from clustermcl import ClusterMCL, Reading
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.steps import LaserReading, OdometryReading, Scan
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.step_maker import StepMaker
from clustermcl.simulator.sensors import LidarModel
from clustermcl.simulator.simulation import Simulation, Tick
from tests.integration.system.conftest import SMALL
from tests.unit.clustermcl.tags import OFFICE, is_right

ALL_ROUND = LidarModel(beams=360, field_of_view_rad=math.radians(359.0))
POSTS = [slice(first, first + 20) for first in (20, 110, 200, 290)]
POST_M = 0.25


def ticks(count: int, seed: int = 0) -> Iterator[Tick]:
    return islice(Simulation(OFFICE, seed, lidar=ALL_ROUND), count)


def with_posts(reading: LaserReading | OdometryReading) -> LaserReading | OdometryReading:
    if isinstance(reading, OdometryReading):
        return reading
    ranges = reading.ranges.array().copy()
    for number, post in enumerate(POSTS):
        ranges[post] = POST_M + 0.01 * math.sin(reading.stamp_ns * 1e-8 + number)
    return replace(reading, ranges=ArrayBlob.of(ranges, "float32"))


def steps_with_posts(maker: StepMaker, count: int = 200) -> list[Scan]:
    readings = (with_posts(reading) for tick in ticks(count) for reading in tick.readings)
    return list(maker.all_steps(readings))


def test_beams_that_end_on_the_robot_are_left_out_and_named() -> None:
    maker = StepMaker(BridgeSettings(), "map", "test")
    steps = steps_with_posts(maker)
    (found,) = [step.step for step in steps if step.own_robot_found]
    assert 0 < found < 20
    for step in steps:
        at_posts = [step.ranges.array()[post] for post in POSTS]
        assert all((ranges == 0.0).all() == (step.step >= found) for ranges in at_posts)
    assert maker.dropped == {Cause.OWN_ROBOT: 1}
    (told,) = [remark.detail for step in steps for remark in step.remarks]
    assert told == (
        "80 of 360 beams, -160 to -140, -70 to -51, 20 to 40, 111 to 130 deg in its frame, "
        "end within 0.25 m in nearly all scans and are left out"
    )


def test_walls_beside_a_robot_are_not_taken_for_it() -> None:
    maker = StepMaker(BridgeSettings(), "map", "test")
    list(maker.all_steps(reading for tick in ticks(1500) for reading in tick.readings))
    assert not maker.dropped


@pytest.mark.parametrize("least_m", [0.0, 0.3])
def test_the_least_range_of_the_settings_holds_for_all_sources(least_m: float) -> None:
    maker = StepMaker(BridgeSettings(min_range_m=least_m), "map", "test")
    (first, *_) = steps_with_posts(maker, count=1)
    assert (first.ranges.array()[POSTS[0]] == 0.0).all() == (least_m > POST_M)


@pytest.mark.filterwarnings("ignore:robot before its laser:UserWarning")
def test_a_laser_that_sees_its_own_robot_is_found_in_the_office() -> None:
    """Without the mask the robot is lost on 98 % of the steps."""
    mcl = ClusterMCL(OFFICE.map, settings=SMALL, seed=0)
    rights, states = [], []
    for tick in ticks(400):
        for reading in tick.readings:
            if belief := mcl.update(Reading.of(with_posts(reading))):
                states.append(belief.state)
                rights.append(bool(belief.hypotheses) and is_right(belief, tick))
    assert states.count("lost") < 20
    assert all(rights[-40:])
    assert states[-40:] == ["localized"] * 40
