import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.filter.motion.trajectory import PoseTuple, Trajectory
from tests.unit.recordings.logs import seconds

S = 1_000_000_000


def through(*poses: tuple[float, PoseTuple], most: int | None = None) -> Trajectory:
    trajectory = Trajectory(most)
    for stamp_s, pose in poses:
        trajectory.add(seconds(stamp_s), pose)
    return trajectory


DRIVING = through((1.0, (0, 0, 0)), (2.0, (1, -2, 0.5)))


def test_a_pose_is_interpolated_between_known_poses_which_are_returned_exactly() -> None:
    assert DRIVING.pose_at(seconds(1.25)) == pytest.approx((0.25, -0.5, 0.125))
    assert DRIVING.pose_at(seconds(2.0)) == (1, -2, 0.5)


@given(heading=st.floats(-math.pi, 3.14), turn=st.floats(-3.1, 3.1), share=st.floats(0, 1))
def test_no_heading_in_between_is_farther_away_than_the_ends(
    heading: float, turn: float, share: float
) -> None:
    end = math.remainder(heading + turn, math.tau)
    pose = through((0.0, (0, 0, heading)), (1.0, (0, 0, end))).pose_at(seconds(share))
    assert pose is not None
    turned = abs(math.remainder(pose[2] - heading, math.tau))
    assert turned == pytest.approx(abs(turn) * share, abs=1e-8)  # stamps are whole nanoseconds


@pytest.mark.parametrize(
    ("stamp_s", "x"), [(0.7, None), (0.8, -0.2), (2.25, 1.25), (2.3, None), (100.0, None)]
)
def test_only_shortly_outside_the_known_times_the_motion_is_extrapolated(
    stamp_s: float, x: float | None
) -> None:
    pose = DRIVING.pose_at(seconds(stamp_s))
    assert (pose[0] if pose else None) == (x if x is None else pytest.approx(x))


def test_a_trajectory_of_one_pose_knows_only_its_time() -> None:
    alone = through((1.0, (1, 2, 3)))
    assert alone.pose_at(seconds(1.2)) == (1, 2, 3)
    assert alone.pose_at(seconds(1.5)) is None
    assert Trajectory().pose_at(0) is None


def test_a_gap_in_odometry_is_interpolated_only_if_the_robot_stood() -> None:
    stayed = through((0.0, (0, 0, 0)), (200.0, (0.5, 0, 0)))
    assert stayed.pose_at(seconds(100.0)) == pytest.approx((0.25, 0, 0))
    moved = through((0.0, (0, 0, 0)), (200.0, (5.0, 0, 0)))
    assert moved.pose_at(seconds(100.0)) is None


def test_late_poses_find_their_place_and_old_ones_go() -> None:
    trajectory = through((1, (1, 0, 0)), (3, (3, 0, 0)), (2, (9, 0, 0)), most=2)
    assert trajectory.pose_at(seconds(2.5)) == pytest.approx((6, 0, 0))
    assert trajectory.pose_at(seconds(1)) is None
    assert trajectory.reaches(seconds(3))
    assert not trajectory.reaches(seconds(3.1))
    trajectory.clear()
    assert not trajectory.reaches(0)


def test_two_poses_of_one_time_do_not_divide_by_zero() -> None:
    trajectory = through((1, (1, 0, 0)), (1, (1, 1, 0)))
    assert trajectory.pose_at(seconds(1.1)) == (1, 1, 0)


@pytest.mark.parametrize("rate_hz", [1, 10, 333])
def test_a_thinned_trajectory_has_a_pose_at_any_time_of_the_last_seconds(rate_hz: int) -> None:
    thinned = Trajectory(most=51, every_ns=S // 10)
    for tick in range(8 * rate_hz + 1):
        thinned.add(tick * S // rate_hz, (0.5 * tick / rate_hz, 0.0, 0.0))
    assert len(thinned) <= 51
    for at_s in (3.0, 3.05, 4.234, 7.999):
        assert thinned.pose_at(int(at_s * S)) == pytest.approx((0.5 * at_s, 0.0, 0.0))


def test_a_clock_that_was_set_back_restarts_the_trajectory() -> None:
    trajectory = through((4.0, (1, 0, 0)), (5.0, (2, 0, 0)), (3.9, (7, 0, 0)))
    assert (trajectory.oldest_ns, trajectory.newest_ns) == (seconds(3.9), seconds(3.9))
    assert len(trajectory) == 1
