import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from particle_filter.trajectory import OdometryBuffer
from protocol.message import PoseTuple
from tests.unit.recordings.logs import seconds


def buffer_of(*poses: tuple[float, PoseTuple], capacity: int = 200) -> OdometryBuffer:
    buffer = OdometryBuffer(capacity)
    for stamp_s, pose in poses:
        buffer.add(seconds(stamp_s), pose)
    return buffer


DRIVING = buffer_of((1.0, (0, 0, 0)), (2.0, (1, -2, 0.5)))


def test_between_two_poses_it_is_interpolated() -> None:
    assert DRIVING.at(seconds(1.25)) == pytest.approx((0.25, -0.5, 0.125))


def test_a_known_pose_comes_back_exactly() -> None:
    assert DRIVING.at(seconds(2.0)) == (1, -2, 0.5)


def test_the_heading_turns_the_short_way_round() -> None:
    buffer = buffer_of((1.0, (0, 0, math.pi - 0.1)), (2.0, (0, 0, -math.pi + 0.3)))
    pose = buffer.at(seconds(1.5))
    assert pose is not None
    assert pose[2] == pytest.approx(-math.pi + 0.1)


@given(heading=st.floats(-math.pi, 3.14), turn=st.floats(-3.1, 3.1), share=st.floats(0, 1))
def test_no_heading_in_between_is_farther_away_than_the_ends(
    heading: float, turn: float, share: float
) -> None:
    end = math.remainder(heading + turn, math.tau)
    pose = buffer_of((0.0, (0, 0, heading)), (1.0, (0, 0, end))).at(seconds(share))
    assert pose is not None
    turned = abs(math.remainder(pose[2] - heading, math.tau))
    assert turned == pytest.approx(abs(turn) * share, abs=1e-8)  # stamps are whole nanoseconds


@pytest.mark.parametrize(("stamp_s", "x"), [(0.8, -0.2), (2.25, 1.25)])
def test_a_little_outside_the_motion_goes_on(stamp_s: float, x: float) -> None:
    pose = DRIVING.at(seconds(stamp_s))
    assert pose is not None
    assert pose[0] == pytest.approx(x)


@pytest.mark.parametrize("stamp_s", [0.7, 2.3, 100.0])
def test_farther_outside_nothing_is_known(stamp_s: float) -> None:
    assert DRIVING.at(seconds(stamp_s)) is None


def test_of_one_pose_only_its_own_time_is_known() -> None:
    alone = buffer_of((1.0, (1, 2, 3)))
    assert alone.at(seconds(1.2)) == (1, 2, 3)
    assert alone.at(seconds(1.5)) is None
    assert OdometryBuffer().at(0) is None


def test_a_gap_is_bridged_only_where_the_robot_stayed() -> None:
    stayed = buffer_of((0.0, (0, 0, 0)), (200.0, (0.5, 0, 0)))
    assert stayed.at(seconds(100.0)) == pytest.approx((0.25, 0, 0))
    moved = buffer_of((0.0, (0, 0, 0)), (200.0, (5.0, 0, 0)))
    assert moved.at(seconds(100.0)) is None


def test_late_poses_find_their_place_and_old_ones_go() -> None:
    buffer = buffer_of((1, (1, 0, 0)), (3, (3, 0, 0)), (2, (9, 0, 0)), capacity=2)
    assert buffer.at(seconds(2.5)) == pytest.approx((6, 0, 0))
    assert buffer.at(seconds(1)) is None
    assert buffer.reaches(seconds(3))
    assert not buffer.reaches(seconds(3.1))
    buffer.clear()
    assert not buffer.reaches(0)


def test_two_poses_of_one_time_do_not_divide_by_zero() -> None:
    buffer = buffer_of((1, (1, 0, 0)), (1, (1, 1, 0)))
    assert buffer.at(seconds(1.1)) == (1, 1, 0)
