import math
from collections.abc import Sequence
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.filter.poses import between
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.causes import Cause
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.steps import LaserReading, Reading, Scan
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.stages import MAX_WAITING_SCANS
from clustermcl.sensor_bridge.step_maker import MotionGate, StepMaker
from tests.unit.filter.naive_rays import cast_rays
from tests.unit.filter.rooms import CELL_M, plain_room
from tests.unit.recordings.logs import ORIGIN, laser_reading, odometry_reading, seconds


def a_maker(lockstep: bool = False, live: bool = False) -> StepMaker:
    return StepMaker(BridgeSettings(), "digest", "bridge", 0, lockstep, live)


def driving(*places_m: float) -> list[LaserReading]:
    """Scans that know their odometry, a second apart."""
    return [laser_reading(float(i), (x, 0.0, 0.0)) for i, x in enumerate(places_m)]


def made_of(*readings: Reading, maker: StepMaker | None = None) -> list[Scan]:
    return list((maker or a_maker()).all_steps(readings))


# --- gate and numbers ---------------------------------------------------------------------------


def test_the_first_scan_is_a_step_and_the_next_after_enough_driving() -> None:
    steps = made_of(*driving(0.0, 0.1, 0.19, 0.2, 0.3, 0.41))
    assert [step.odom_from_robot[0] for step in steps] == [0.0, 0.2, 0.41]
    assert len(made_of(*driving(*[1.0] * 50))) == 1, "a robot that stands"


def test_the_turn_of_the_motion_gate_is_wrapped() -> None:
    headings = (3.0, 3.1, -3.1, -3.0)  # 3.0 to -3.1 is 0.183 rad across the half turn
    steps = made_of(*(laser_reading(i, (0, 0, h)) for i, h in enumerate(headings)))
    assert [step.odom_from_robot[2] for step in steps] == [3.0, -3.0]


def test_live_settings_apply_from_the_next_step_which_carries_them() -> None:
    maker, live = a_maker(), LiveSettings(gate_distance_m=0.05, max_beams=9)
    steps = []
    for number, reading in enumerate(driving(0.0, 0.05, 0.1, 0.11, 0.16, 0.3, 0.37)):
        if number in (2, 5):
            maker.configure(live if number == 2 else AS_STARTED)
        if (scan := maker.on_reading(reading)) is not None:
            steps.append(scan)
    assert [step.odom_from_robot[0] for step in steps] == [0.0, 0.1, 0.16, 0.37]
    assert [step.settings for step in steps] == [AS_STARTED, live, live, AS_STARTED]


def test_one_step_is_forced_and_the_next_is_measured_from_there() -> None:
    maker = a_maker()
    first, second, *others = driving(0.0, 0.15, 0.2, 0.34, 0.36)
    maker.on_reading(first)
    maker.gate.open_next()
    maker.on_reading(second)
    assert [maker.on_reading(other) is not None for other in others] == [False, False, True]


def test_a_step_has_the_fields_of_its_scan() -> None:
    reading = laser_reading(2.0, (1.0, 2.0, 0.5))
    double = msgspec.structs.replace(reading, ranges=ArrayBlob.of([1.0, 2.0, 3.0], "float64"))
    [step] = made_of(double, maker=a_maker(lockstep=True, live=True))
    assert (step.map_digest, step.sender) == ("digest", "bridge")
    assert (step.lockstep, step.live) == (True, True)
    for field in ("stamp_ns", "odom_from_robot", "robot_from_laser", "ranges", "range_max_m"):
        assert getattr(step, field) == getattr(reading, field)


# --- scans and odometry -------------------------------------------------------------------------


def test_a_scan_waits_for_the_odometry_after_it() -> None:
    maker = a_maker()
    assert maker.on_reading(odometry_reading(1.0, (0.0, 0.0, 0.0))) is None
    assert maker.on_reading(laser_reading(1.5)) is None
    step = maker.on_reading(odometry_reading(2.0, (1.0, 0.0, 0.0)))
    assert step is not None
    assert step.odom_from_robot == pytest.approx((0.5, 0.0, 0.0))
    assert maker.on_reading(laser_reading(2.2)) is None
    last = maker.finish()
    assert last is not None
    assert last.odom_from_robot == pytest.approx((1.2, 0.0, 0.0))


def test_a_scan_without_odometry_near_its_time_is_dropped() -> None:
    maker = a_maker()
    assert made_of(laser_reading(1.0), odometry_reading(9.0), maker=maker) == []
    assert maker.dropped == {Cause.NO_ODOMETRY: 1}
    assert made_of(laser_reading(9.5), maker=maker) == []
    assert maker.dropped == {Cause.NO_ODOMETRY: 2, Cause.LASER_SILENT: 1}


def test_the_oldest_waiting_scan_is_dropped_when_too_many_wait() -> None:
    maker = a_maker()
    for i in range(MAX_WAITING_SCANS + 3):
        assert maker.on_reading(laser_reading(i / 10)) is None
    assert maker.dropped == {Cause.NO_ODOMETRY: 3}


def test_several_steps_that_become_ready_at_once_are_all_made() -> None:
    readings: list[Reading] = [odometry_reading(0.0)]
    readings += [laser_reading(t) for t in (0.3, 0.6, 0.9)]
    steps = made_of(*readings, odometry_reading(1.0, (3.0, 0.0, 0.0)))
    assert [step.odom_from_robot[0] for step in steps] == pytest.approx([0.9, 1.8, 2.7])
    assert [step.step for step in steps] == [0, 1, 2]


def test_odometry_is_that_of_the_newest_stamp() -> None:
    maker = a_maker()
    assert maker.odometry is None
    maker.on_reading(odometry_reading(1.0, (1.0, 0.0, 0.0)))
    maker.on_reading(laser_reading(2.0, (2.0, 0.0, 0.0)))
    maker.on_reading(odometry_reading(1.5, (1.5, 0.0, 0.0)))
    assert maker.odometry == (seconds(2.0), (2.0, 0.0, 0.0))


# --- useless readings ---------------------------------------------------------------------------


def with_ranges(ranges: Sequence[float]) -> LaserReading:
    return laser_reading(0.0, ORIGIN, ranges)


def changed(**fields: object) -> LaserReading:
    return msgspec.structs.replace(laser_reading(0.0, ORIGIN), **fields)


@pytest.mark.parametrize(
    ("reading", "cause"),
    [
        (with_ranges([]), Cause.NO_BEAMS),
        (with_ranges([1.0] * 20_001), Cause.TOO_MANY_BEAMS),
        (with_ranges([math.nan] * 3), Cause.NO_RETURNS),
        (with_ranges([0.0, -1.0, 10.0, math.inf]), Cause.NO_RETURNS),
        (changed(range_max_m=math.nan), Cause.NOT_FINITE),
        (changed(range_max_m=-1.0), Cause.NO_RETURNS),
        (changed(angle_min_rad=math.nan), Cause.NOT_FINITE),
        (changed(angle_step_rad=math.inf), Cause.NOT_FINITE),
        (changed(angle_step_rad=0.0), Cause.BAD_GEOMETRY),
        (changed(angle_step_rad=5.0), Cause.BAD_GEOMETRY),
        (changed(robot_from_laser=(0.0, math.nan, 0.0)), Cause.NOT_FINITE),
        (changed(odom_from_robot=(0.0, 0.0, math.inf)), Cause.NOT_FINITE),
        (changed(odom_from_robot=(1e300, 0.0, 0.0)), Cause.NOT_FINITE),
        (changed(stamp_ns=2**62), Cause.NOT_FINITE),
        (changed(ranges=ArrayBlob(dtype="float32", shape=(3,), data=b"123")), Cause.MALFORMED),
        (changed(ranges=ArrayBlob.of(np.ones((2, 2)), "float32")), Cause.MALFORMED),
        (odometry_reading(0.0, (math.nan, 0.0, 0.0)), Cause.NOT_FINITE),
    ],
)
def test_a_useless_reading_is_counted_and_changes_nothing(reading: Reading, cause: Cause) -> None:
    maker = a_maker()
    assert made_of(reading, maker=maker) == []
    assert maker.dropped == {cause: 1}
    assert "stamp" in maker.dropped.details[cause]
    assert [step.step for step in made_of(*driving(0.0), maker=maker)] == [0]


# --- time and frames ----------------------------------------------------------------------------


def test_a_reading_may_be_a_little_late_but_not_more() -> None:
    maker = a_maker()
    poses = {10.0: 0.0, 9.1: 1.0, 8.9: 2.0, 10.5: 3.0}
    steps = made_of(*(laser_reading(t, (x, 0.0, 0.0)) for t, x in poses.items()), maker=maker)
    assert [step.odom_from_robot[0] for step in steps] == [0.0, 1.0, 3.0]
    assert maker.dropped == {Cause.STEPS_BACK: 1}


def test_a_jump_of_odometry_is_removed() -> None:
    maker = a_maker()
    before = [laser_reading(t, (t + 40.0, 0.0, 0.0)) for t in (10.0, 11.0)]
    restarted = [laser_reading(t, (t - 11.9, 0.0, 0.0)) for t in (12.0, 13.0)]
    steps = made_of(*before, *restarted, maker=maker)
    # the robot drove on: 50, 51, no motion over the jump, one metre more
    assert [step.odom_from_robot[0] for step in steps] == pytest.approx([50.0, 51.0, 52.0])
    assert maker.dropped == {Cause.ODOMETRY_JUMPED: 1}


def test_a_step_carries_the_motion_by_scans_if_odometry_contradicts_it() -> None:
    """The robot drives ahead, and its odometry backwards at one step."""
    angles, odometry_m, readings = np.linspace(-3.1, 3.1, 180), (0.0, 0.3, 0.0, 0.3), []
    for number, x in enumerate(odometry_m):
        pose = np.array([2.6 + 0.3 * number, 2.8, 0.4])
        ranges = cast_rays(plain_room(), CELL_M, pose, angles, 8.0)
        reading = replace(
            laser_reading(float(number), (x, 0.0, 0.4), ranges),
            angle_min_rad=float(angles[0]),
            angle_step_rad=float(angles[1] - angles[0]),
        )
        readings.append(reading)
    maker = a_maker()
    motions = [step.motion_by_scans for step in made_of(*readings, maker=maker)]
    assert [motion is None for motion in motions] == [True, True, False, True]
    expected = between(np.array([0.0, 0.0, 0.4]), np.array([0.3, 0.0, 0.4]))
    assert motions[2] == pytest.approx(expected, abs=0.1)
    assert dict(maker.dropped) == {Cause.ODOMETRY_CONTRADICTED: 1}


def faulty_drive(fault: str) -> list[Reading]:
    """Six seconds at 0.5 m/s; the fault is at 3 s, where the odometry of a reset begins again."""
    readings = list[Reading]()
    for i in range(120):
        t, back_s = i / 20, 2.0 if fault == "clock" and i >= 60 else 0.0
        x = 0.5 * t + 1.0 - (2.5 if fault == "reset" and i >= 60 else 0.0)
        readings.append(odometry_reading(t - back_s, (x, 0.0, 0.0)))
        if i % 2 == 0 and not (fault == "silent" and 60 <= i < 110):
            readings.append(laser_reading(t - back_s, None))
    return readings


@pytest.mark.parametrize(
    ("fault", "remarks"),
    [
        ("none", {}),
        # After three readings a robot at 10 m/s could have driven this jump.
        ("reset", {"odometry jumped": "by 2.48 m and 0 deg"}),
        ("silent", {"laser silent": "for 2.6 s"}),
        (
            "clock",
            {"reading refused: stamp steps back": "19 times", "clock restarted": "1.9 s back"},
        ),
    ],
)
def test_the_next_step_carries_what_was_bridged_or_missed(
    fault: str, remarks: dict[str, str]
) -> None:
    steps = made_of(*faulty_drive(fault))
    carried = [step.remarks for step in steps if step.remarks]
    assert [{one.cause: one.detail for one in each} for each in carried] == (
        [remarks] if remarks else []
    )
    places_m = [step.odom_from_robot[0] for step in steps]
    if fault == "reset":
        assert all(0.0 <= b - a < 0.5 for a, b in pairwise(places_m)), "no motion over the jump"


def test_steps_carry_a_cause_that_repeats_once_a_minute() -> None:
    jumping = [laser_reading(t, ((t % 2) * 50.0 + t, 0.0, 0.0)) for t in range(100)]
    carried = [remark.detail for step in made_of(*jumping) for remark in step.remarks]
    assert carried == ["", "30 times"]


def quiet_drive() -> list[Reading]:
    quiet: list[Reading] = []
    for i in range(40):
        quiet.append(odometry_reading(i / 10, (i / 10, 0.0, 0.0)))
        quiet.append(laser_reading(i / 10 + 0.01, None if i % 2 else (i / 10, 0.0, 0.0)))
    return quiet


STRAYS = [
    odometry_reading(1e6),
    laser_reading(1e6),
    laser_reading(1e6, ORIGIN),
    odometry_reading(1.0, (500.0, 0.0, 0.0)),
    laser_reading(1.0, (0.0, -100.0, 0.0)),
    odometry_reading(-1e6, (500.0, 0.0, 0.0)),
    laser_reading(-1e6),
]


@given(at=st.integers(2, 78), which=st.lists(st.sampled_from(STRAYS), max_size=2))
def test_up_to_two_outliers_in_time_or_place_have_no_effect(at: int, which: list[Reading]) -> None:
    quiet = quiet_drive()
    maker = a_maker()
    disturbed = made_of(*quiet[:at], *which, *quiet[at:], maker=maker)
    assert [msgspec.structs.replace(one, remarks=()) for one in disturbed] == made_of(*quiet)
    assert maker.dropped.total() == len(which)


def test_a_clock_that_was_set_ahead_is_followed_at_once_and_nothing_is_lost() -> None:
    readings = driving(*(i / 10 for i in range(40)))
    set_ahead = [
        msgspec.structs.replace(late, stamp_ns=late.stamp_ns + seconds(3600.0))
        for late in readings[10:]
    ]
    maker = a_maker()
    steps = made_of(*readings[:10], *set_ahead, maker=maker)
    undisturbed = [step.odom_from_robot for step in made_of(*readings)]
    assert [step.odom_from_robot for step in steps] == undisturbed
    assert maker.dropped == {Cause.LASER_SILENT: 1}, "as far as stamps tell"


@pytest.mark.parametrize(
    ("elapsed_s", "pose", "jumps"),
    [
        (0.1, (1.5, 0.0, 0.0), 0),
        (0.1, (2.5, 0.0, 0.0), 1),
        (0.1, (0.0, 0.0, 1.9), 0),
        (0.1, (0.0, 0.0, 2.5), 1),
        (60.0, (90.0, 0.0, 3.0), 0),
        (60.0, (110.0, 0.0, 0.0), 1),
    ],
)
def test_a_jump_is_a_motion_that_no_robot_can_make(
    elapsed_s: float, pose: PoseTuple, jumps: int
) -> None:
    maker = a_maker()
    maker.on_reading(odometry_reading(0.0))
    maker.on_reading(odometry_reading(elapsed_s, pose))
    maker.finish()
    assert maker.dropped[Cause.ODOMETRY_JUMPED] == jumps


# --- a robot that stands -----------------------------------------------------------------------


def test_a_robot_that_has_moved_less_than_a_quarter_of_the_gate_counts_as_standing() -> None:
    gate = MotionGate(BridgeSettings(gate_distance_m=0.2, gate_turn_rad=0.2))
    assert not gate.has_hardly_moved((0.0, 0.0, 0.0))
    assert gate.on_scan((1.0, 0.0, 0.0))
    assert gate.has_hardly_moved((1.04, 0.0, 0.04))
    assert not gate.has_hardly_moved((1.06, 0.0, 0.0))
    assert not gate.has_hardly_moved((1.0, 0.0, -0.06))
    gate.begin_again()
    assert gate.on_scan((1.0, 0.0, 0.0))
