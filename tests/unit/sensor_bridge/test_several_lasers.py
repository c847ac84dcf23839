import math
from collections.abc import Sequence

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.causes import Cause
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.reading_checks import MAX_LASERS
from clustermcl.protocol.steps import LaserReading, Reading
from clustermcl.sensor_bridge.stages import RESTART_AFTER
from tests.unit.recordings.logs import laser_reading, odometry_reading
from tests.unit.sensor_bridge.test_step_maker import a_maker, made_of

FRONT: PoseTuple = (0.3, 0.0, 0.0)
REAR: PoseTuple = (-0.3, 0.1, math.pi)


def laser(name: str, at_s: float, mount: PoseTuple, ranges: Sequence[float] = (1, 2, 3)) -> Reading:
    reading = laser_reading(at_s, None, ranges)
    return msgspec.structs.replace(reading, laser=name, robot_from_laser=mount)


def drive(seconds: float = 4.0) -> list[Reading]:
    """A metre a second; odometry at 20 Hz, the front laser at 10 and the rear one at 5 Hz."""
    readings: list[Reading] = []
    for tick in range(int(20 * seconds)):
        at_s = tick / 20
        readings.append(odometry_reading(at_s, (at_s, 0.0, 0.0)))
        if tick % 2 == 0:
            readings.append(laser("front", at_s + 0.01, FRONT, (1, 2, 1 + at_s)))
        if tick % 4 == 1:
            readings.append(laser("rear", at_s + 0.02, REAR, (4, 5, 1 + at_s)))
    return readings


def test_a_step_includes_the_newest_scan_of_the_other_laser() -> None:
    steps = made_of(*drive())
    used = [step.ranges.data for step in steps]
    used += [other.ranges.data for step in steps for other in step.others]
    assert len(set(used)) == len(used), "no scan is used twice"
    driven_m = np.diff([step.odom_from_robot[0] for step in steps])
    assert np.all(driven_m >= 0.2), "together they make no more steps than one does"
    for step in steps[1:]:
        (other,) = step.others
        assert {step.ranges.array()[0], other.ranges.array()[0]} == {1.0, 4.0}
        is_front = other.ranges.array()[0] == 1.0
        mount, delay_s = (FRONT, 0.01) if is_front else (REAR, 0.02)
        assert {step.robot_from_laser, mount} == {FRONT, REAR}
        # The robot has driven on since, a metre a second, and left the laser's place behind.
        since_m = step.odom_from_robot[0] - (other.ranges.array()[2] - 1 + delay_s)
        assert 0.0 < since_m < 0.2
        at = np.subtract(other.robot_from_laser, (mount[0] - since_m, *mount[1:]))
        np.testing.assert_allclose(np.abs(at) % math.tau, 0.0, atol=1e-6)


def is_rear(reading: Reading) -> bool:
    return isinstance(reading, LaserReading) and reading.laser == "rear"


def is_front(reading: Reading) -> bool:
    return isinstance(reading, LaserReading) and reading.laser == "front"


def test_an_old_scan_of_another_laser_joins_no_step() -> None:
    readings = [one for one in drive() if not is_rear(one) or one.stamp_ns < 1_000_000_000]
    late = [step for step in made_of(*readings) if step.odom_from_robot[0] > 1.5]
    assert late
    assert all(step.others == () for step in late)


def test_when_the_first_laser_falls_silent_the_other_makes_the_steps() -> None:
    silent = [one for one in drive() if one.stamp_ns < 10**9 or not is_front(one)]
    assert [step.robot_from_laser for step in made_of(*silent)[-3:]] == [REAR] * 3


def test_a_laser_alone_makes_the_same_steps_whatever_it_is_called() -> None:
    named = [one for one in drive() if not is_rear(one)]
    unnamed = [msgspec.structs.replace(one, laser="") if is_front(one) else one for one in named]
    assert made_of(*named) == made_of(*unnamed)


@given(
    ahead_s=st.sampled_from([-1e6, -30.0, -1.5, 1.5, 30.0, 1e6]),
    odometry=st.sampled_from([None, (500.0, 0.0, 0.0)]),
)
def test_a_second_laser_with_a_wrong_clock_changes_no_step(
    ahead_s: float, odometry: PoseTuple | None
) -> None:
    def wrong(reading: Reading) -> Reading:
        if not is_rear(reading):
            return reading
        late_ns = int(ahead_s * 1e9)
        return msgspec.structs.replace(
            reading, stamp_ns=reading.stamp_ns + late_ns, odom_from_robot=odometry
        )

    quiet, maker = [one for one in drive() if not is_rear(one)], a_maker()
    disturbed = made_of(*map(wrong, drive()), maker=maker)
    assert [msgspec.structs.replace(one, remarks=()) for one in disturbed] == made_of(*quiet)
    assert maker.dropped == {Cause.OUTLIER: sum(map(is_rear, drive()))}


def test_with_odometry_in_each_scan_another_laser_takes_over_from_a_silent_one() -> None:
    def scan(name: str, at_s: float) -> Reading:
        reading = laser(name, at_s, FRONT)
        return msgspec.structs.replace(reading, odom_from_robot=(at_s, 0.0, 0.0))

    before = [scan(name, tick / 10) for tick in range(10) for name in ("a", "b")]
    after = [scan("b", 1 + tick / 10) for tick in range(3 * RESTART_AFTER)]
    steps = made_of(*before, *after)
    assert steps[-1].odom_from_robot[0] == pytest.approx(1 + (3 * RESTART_AFTER - 1) / 10, abs=0.2)


def test_too_many_lasers_are_counted() -> None:
    maker = a_maker()
    readings = [laser(f"laser {n}", n / 100, FRONT) for n in range(MAX_LASERS + 2)]
    made_of(odometry_reading(0.0), *readings, odometry_reading(0.5), maker=maker)
    assert maker.dropped[Cause.TOO_MANY_LASERS] == 2


# --- what a laser says of itself ----------------------------------------------------------------


def test_ranges_below_the_lasers_minimum_are_no_returns() -> None:
    reading = laser_reading(0.0, (0.0, 0.0, 0.0), [0.05, 0.1, 2.0, math.inf, math.nan])
    reading = msgspec.structs.replace(reading, range_min_m=0.1)
    assert made_of(reading)[0].ranges.array().tolist()[:4] == [0.0, pytest.approx(0.1), 2, math.inf]
    near = msgspec.structs.replace(reading, range_min_m=3.0)
    maker = a_maker()
    assert made_of(near, maker=maker) == []
    assert maker.dropped == {Cause.NO_RETURNS: 1}
