import math
from collections.abc import Iterable

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from clustermcl.filter.cluster.view_memory import MAX_VIEWS, MOST, ViewMemory
from clustermcl.filter.settings import BeliefSettings, MotionSettings
from tests.unit.filter.rooms import PERFECT_ODOMETRY as PERFECT

RULES = BeliefSettings(view_distance_m=0.8, view_turn_rad=1.6)
ODOMETRY = MotionSettings()
Motion = tuple[float, float, float]
DRIVE, TURN = (0.2, 0.0, 0.0), (0.0, 0.0, 2.0 * math.pi / 31.0)
AROUND = (0.0, 0.0, math.pi)


def weights(
    motions: Iterable[Motion], odometry: MotionSettings = ODOMETRY, memory: ViewMemory | None = None
) -> list[float]:
    """Of a first scan, and of one after each motion."""
    memory, found = memory or ViewMemory(), []
    for motion in ((0.0, 0.0, 0.0), *motions):
        weight, memory = memory.after(np.array(motion), odometry, RULES)
        found.append(weight)
        assert memory.problem is None
    return found


def test_on_a_straight_drive_the_new_share_depends_on_the_distance_since_the_last_scan() -> None:
    first, *others = weights([DRIVE] * 50, PERFECT)
    assert first == 1.0
    assert others == pytest.approx([1.0 - math.exp(-0.25)] * 50, rel=1e-5)


def test_the_memory_of_the_present_scan_holds_it_once() -> None:
    again, next_one = weights([DRIVE], PERFECT, ViewMemory.of_this_scan())
    assert (again, next_one) == (0.0, pytest.approx(1.0 - math.exp(-0.25), rel=1e-5))


def test_a_robot_that_stands_sees_nothing_new() -> None:
    assert weights([(0.0, 0.0, 0.0)] * 9) == [1.0, *[0.0] * 9]


def test_turning_on_the_spot_shows_each_view_once() -> None:
    around = weights([TURN] * 31 * 15)
    assert 2.5 < math.fsum(around[:32]) < 2.0 * math.pi / 1.6 + 1.0
    assert math.fsum(around[32:]) < 0.5, "fourteen turns more"


def test_going_back_and_forth_shows_each_view_once() -> None:
    there_and_back = [*[DRIVE] * 10, AROUND]
    seen, known = weights(there_and_back * 10), weights(there_and_back * 10, PERFECT)
    assert math.fsum(seen[22:]) < 0.5 * math.fsum(seen[:22]), "nine times as much of the way"
    assert math.fsum(known[22:]) < 0.01 * math.fsum(known[:22])
    shuffled = [(0.2 * step, 0.0, 0.0) for step in (5, -3, 2, 4, -6, 1, 3, -4)]
    assert math.fsum(weights([*[DRIVE] * 10, (-2.0, 0.0, 0.0), *shuffled], PERFECT)[12:]) < 0.1


def test_a_view_near_an_earlier_one_is_added_to_it() -> None:
    memory, weight = ViewMemory(), 0.0
    for x_m in (0.0, 0.4, 0.4, 0.1):
        before = memory.rows
        weight, memory = memory.after(np.array([x_m, 0.0, 0.0]), PERFECT, RULES)
    assert len(memory.rows) == len(before) == 3
    assert memory.rows[-1, 3] == pytest.approx(before[-1, 3] + weight)
    np.testing.assert_array_equal(memory.rows[:-1, 3], before[:-1, 3])


def test_old_views_fade_with_the_error_of_odometry() -> None:
    """After a loop of 40 m it is known that the robot is back; after one of 80 m it is not."""

    def seen_again(steps: int) -> float:
        loop = [(0.2, 0.0, 2.0 * math.pi / steps)] * steps
        around = weights([*loop, *loop[:20]])
        return math.fsum(around[steps + 1 :]) / math.fsum(around[1:21])

    assert seen_again(200) < 0.1
    assert seen_again(400) > 0.9


def test_a_view_whose_pose_is_uncertain_is_wider_and_counts_less() -> None:
    """A correlation exp(-d) that errors blur keeps its integral, and its variance grows by theirs:
    6 d^2 in the plane, and 2 d^2 of the heading."""
    memory = ViewMemory(np.array([0.3, 0.4, 0.5, 0.9, 0.6, 0.7], "<f4").tobytes())
    wide_m, wide_rad = math.sqrt(0.8**2 + 0.6 / 6.0), math.sqrt(1.6**2 + 0.7 / 2.0)
    correlated = (0.8 / wide_m) ** 2 * (1.6 / wide_rad) * math.exp(-0.5 / wide_m - 0.5 / wide_rad)
    assert memory.after(np.zeros(3), PERFECT, RULES)[0] == pytest.approx(1.0 - 0.9 * correlated)
    assert memory.new_share(np.zeros((1, 3)), RULES) == pytest.approx([1.0 - 0.9 * correlated])


def test_a_view_is_new_where_the_robot_has_not_looked_from() -> None:
    _, memory = ViewMemory().after(np.zeros(3), PERFECT, RULES)
    poses = np.array([(0.0, 0.0, 0.0), (0.8, 0.0, 0.0), (0.0, 0.0, -1.6), (0.0, 9.0, 0.0)])
    expected = [0.0, 1.0 - math.exp(-1.0), 1.0 - math.exp(-1.0), 1.0]
    np.testing.assert_allclose(memory.new_share(poses, RULES), expected, atol=1e-4)


def test_without_a_view_distance_no_view_is_remembered() -> None:
    every = BeliefSettings(view_distance_m=0.0)
    assert ViewMemory().after(np.zeros(3), ODOMETRY, every) == (1.0, ViewMemory())


NUMBERS = st.floats(-1e8, 1e8) | st.floats(-1.0, 1.0)
MOTIONS = st.tuples(NUMBERS, NUMBERS, st.floats(-math.pi, math.pi))


@hypothesis.given(st.lists(MOTIONS, max_size=30), st.sampled_from([ODOMETRY, PERFECT]))
def test_for_any_motion_the_new_share_is_between_0_and_1(
    motions: list[Motion], odometry: MotionSettings
) -> None:
    assert all(0.0 <= weight <= 1.0 for weight in weights(motions, odometry))


def test_the_view_memory_has_a_fixed_size_and_keeps_its_most_certain_views() -> None:
    memory = ViewMemory()
    for _ in range(2 * MAX_VIEWS + 9):
        _, memory = memory.after(np.array([0.8, 0.0, 0.0]), PERFECT, RULES)
    assert len(memory.views) == 24 * MAX_VIEWS
    assert memory.problem is None
    assert memory.after(np.zeros(3), PERFECT, RULES)[0] < 1e-6
    assert memory.after(np.array([500.0, 0.0, 0.0]), PERFECT, RULES)[0] == 1.0


def test_a_view_memory_that_is_handed_on_continues_with_the_same_results() -> None:
    memory = ViewMemory()
    for _ in range(20):
        _, memory = memory.after(np.array(TURN), ODOMETRY, RULES)
    copy = ViewMemory(bytes(memory.views))
    assert weights([TURN] * 20, memory=copy) == weights([TURN] * 20, memory=memory)


@pytest.mark.parametrize(
    "views",
    [
        b"x" * 23,
        bytes(24 * (MAX_VIEWS + 1)),
        *(
            np.array(row, "<f4").tobytes()
            for row in (
                (math.nan, 0, 0, 1, 0, 0),
                (0, math.inf, 0, 1, 0, 0),
                (0, 0, 0, -0.1, 0, 0),
                (0, 0, 0, 1, -1.0, 0),
                (0, 0, 0, 1, 0, 2 * MOST),
            )
        ),
    ],
)
def test_impossible_seen_views_are_refused(views: bytes) -> None:
    assert ViewMemory(views).problem is not None
    assert ViewMemory(bytes(24)).problem is None
