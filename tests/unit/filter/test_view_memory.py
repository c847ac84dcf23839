import math
from collections.abc import Iterable

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from clustermcl.filter.advice.view_memory import MAX_VIEWS, MOST, ViewMemory

Motion = tuple[float, float, float]
STAY, DRIVE, TURN = (0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.0, 0.0, 2.0 * math.pi / 31.0)
AROUND = (0.0, 0.0, math.pi)


def after(motions: Iterable[Motion], memory: ViewMemory | None = None) -> ViewMemory:
    memory = memory or ViewMemory()
    for motion in motions:
        memory = memory.after(np.array(motion))
        assert memory.problem is None
    return memory


def seen(motions: Iterable[Motion]) -> float:
    """Sum of the weights of all views from the first scan on."""
    return float(after([STAY, *motions]).rows[:, 3].sum())


def test_on_a_straight_drive_the_new_share_depends_on_the_distance_since_the_last_scan() -> None:
    weights = after([STAY] + [DRIVE] * 50).rows[:, 3]
    assert weights.tolist() == pytest.approx([1.0] + [1.0 - math.exp(-0.25)] * 50, rel=1e-5)


def test_the_memory_of_the_present_scan_holds_it_once() -> None:
    assert len(after([STAY], ViewMemory.of_this_scan()).rows) == 1
    assert after([DRIVE], ViewMemory.of_this_scan()).rows[-1, 3] == pytest.approx(0.221, abs=1e-3)


def test_each_view_counts_once() -> None:
    assert seen([STAY] * 9) == 1.0
    assert seen([TURN] * 31 * 15) < 1.1 * seen([TURN] * 31) < 2.0 * math.pi / 1.6 + 1.5
    there_and_back = [*[DRIVE] * 10, AROUND]
    assert seen(there_and_back * 10) < 1.02 * seen(there_and_back * 2)


def test_a_view_is_new_where_the_robot_has_not_looked_from() -> None:
    poses = np.array([(0.0, 0.0, 0.0), (0.8, 0.0, 0.0), (0.0, 0.0, -1.6), (0.0, 9.0, 0.0)])
    expected = [0.0, 1.0 - math.exp(-1.0), 1.0 - math.exp(-1.0), 1.0]
    np.testing.assert_allclose(after([STAY]).new_share(poses), expected, atol=1e-4)


NUMBERS = st.floats(-1e8, 1e8) | st.floats(-1.0, 1.0)
MOTIONS = st.tuples(NUMBERS, NUMBERS, st.floats(-math.pi, math.pi))


@hypothesis.given(st.lists(MOTIONS, max_size=30))
def test_for_any_motion_the_weights_are_between_0_and_1(motions: list[Motion]) -> None:
    weights = after(motions).rows[:, 3]
    assert np.all((weights >= 0.0) & (weights <= 1.0))


def test_the_view_memory_has_a_fixed_size_and_keeps_its_newest_views() -> None:
    memory = after([(0.8, 0.0, 0.0)] * (2 * MAX_VIEWS + 9))
    assert len(memory.views) == 16 * MAX_VIEWS
    assert memory.rows[0, 0] == pytest.approx(-0.8 * (MAX_VIEWS - 1), rel=1e-3)
    assert len(after([(2.0 * MOST, 0.0, 0.0)], memory).rows) == 1, "too far away"


@pytest.mark.parametrize(
    "views",
    [
        b"x" * 15,
        bytes(16 * (MAX_VIEWS + 1)),
        *(
            np.array(row, "<f4").tobytes()
            for row in ((math.nan, 0, 0, 1), (0, math.inf, 0, 1), (0, 0, 0, -0.1), (0, 0, 0, 2e6))
        ),
    ],
)
def test_impossible_seen_views_are_refused(views: bytes) -> None:
    assert ViewMemory(views).problem is not None
    assert ViewMemory(bytes(16)).problem is None
