import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.judge import Accuracy, Judge, pose_error
from protocol.answers import Hypothesis, State
from protocol.message import PoseTuple
from tests.unit.evaluation.places import place

TRUTH: PoseTuple = (10.0, 5.0, 3.0)
RIGHT, WRONG = (10.5, 5.0, 3.0), (14.0, 5.0, 3.0)


def judged(*steps: tuple[State, list[Hypothesis], PoseTuple | None]) -> Accuracy:
    """One step a second, numbered from 0."""
    judge = Judge()
    for number, (state, places, truth) in enumerate(steps):
        judge.on_step(number, (100 + number) * 10**9, state, places, truth)
    return judge.accuracy()


def sure_of(pose: PoseTuple) -> tuple[State, list[Hypothesis], PoseTuple | None]:
    return "localized", [place(0.95, pose), place(0.05, (0.0, 0.0, 0.0))], TRUTH


@pytest.mark.parametrize(
    ("pose", "right"),
    [
        ((10.99, 5.0, 3.0), True),
        ((11.01, 5.0, 3.0), False),
        ((10.0, 5.0, 3.0 + math.radians(19.9) - math.tau), True),
        ((10.0, 5.0, 3.0 + math.radians(20.1)), False),
    ],
)
def test_right_is_within_a_metre_and_twenty_degrees(pose: PoseTuple, right: bool) -> None:
    assert pose_error(pose, TRUTH).right is right


@given(st.tuples(*[st.floats(-50, 50)] * 3), st.tuples(*[st.floats(-50, 50)] * 3))
def test_errors_are_symmetric_and_never_more_than_half_a_turn(a: PoseTuple, b: PoseTuple) -> None:
    there, back = pose_error(a, b), pose_error(b, a)
    assert there.distance_m == back.distance_m >= 0.0
    assert there.heading_rad == pytest.approx(back.heading_rad, abs=1e-9)
    assert 0.0 <= there.heading_rad <= math.pi


def test_localized_means_right_over_the_last_ten_steps() -> None:
    wrong_before = judged(*[sure_of(WRONG)] * 3, *[sure_of(RIGHT)] * 10)
    assert wrong_before.localized
    assert (wrong_before.localized_at_step, wrong_before.localized_at_s) == (3, 3.0)
    one_wrong = judged(*[sure_of(RIGHT)] * 8, sure_of(WRONG), *[sure_of(RIGHT)] * 9)
    assert not one_wrong.localized
    assert one_wrong.localized_at_step is one_wrong.rmse_m is None


def test_a_wrong_step_begins_the_count_anew() -> None:
    verdict = judged(*[sure_of(RIGHT)] * 20, sure_of(WRONG), *[sure_of(RIGHT)] * 12)
    assert verdict.localized_at_step == 21


def test_a_run_shorter_than_ten_steps_is_judged_by_all_of_them() -> None:
    assert judged(*[sure_of(RIGHT)] * 4).localized
    assert not judged(sure_of(WRONG), *[sure_of(RIGHT)] * 3).localized


def test_the_rmse_counts_from_where_it_stayed_right() -> None:
    first, then = sure_of((10.0, 5.9, 3.0)), sure_of((10.0, 5.5, 3.0))
    verdict = judged(sure_of(WRONG), first, *[then] * 10)
    assert verdict.rmse_m == pytest.approx(math.sqrt((0.9**2 + 10 * 0.5**2) / 11))


def test_the_final_error_is_that_of_the_last_judged_step() -> None:
    verdict = judged(sure_of(RIGHT), sure_of((10.0, 5.2, 3.1)), ("localized", [place(1.0)], None))
    assert verdict.final_error_m == pytest.approx(0.2)
    assert verdict.final_error_rad == pytest.approx(0.1)
    assert verdict.steps == 3


def test_only_a_sure_estimate_at_a_wrong_place_is_confidently_wrong() -> None:
    doubtful = ("ambiguous", [place(0.89, WRONG), place(0.11, RIGHT)], TRUTH)
    sure = ("localized", [place(0.9, WRONG)], TRUTH)
    assert judged(sure_of(RIGHT), doubtful, sure, sure).confidently_wrong_fraction == 0.5


def test_a_first_search_claims_nothing() -> None:
    searching: tuple[State, list[Hypothesis], PoseTuple] = "searching", [place(1.0, WRONG)], TRUTH
    verdict = judged(*[searching] * 3, sure_of(RIGHT))
    assert verdict.confidently_wrong_fraction == 0.0
    assert verdict.truth_tracked_fraction == 1.0
    only = judged(searching)
    assert not only.localized
    assert only.final_error_m is only.truth_tracked_fraction is None


def test_the_truth_is_tracked_by_any_place_and_its_probability_adds_up() -> None:
    both = ("ambiguous", [place(0.5, WRONG), place(0.3, RIGHT), place(0.2, TRUTH)], TRUTH)
    none = ("ambiguous", [place(1.0, WRONG)], TRUTH)
    verdict = judged(both, none)
    assert verdict.truth_tracked_fraction == 0.5
    assert verdict.truth_probability_mean == pytest.approx(0.25)


def test_places_forgotten_later_count_against_tracking() -> None:
    forgotten: tuple[State, list[Hypothesis], PoseTuple] = "searching", [], TRUTH
    verdict = judged(sure_of(RIGHT), forgotten)
    assert verdict.truth_tracked_fraction == 0.5
    assert not verdict.localized
    assert verdict.final_error_m is None


def test_without_a_reference_nothing_is_claimed() -> None:
    verdict = judged(*[("localized", [place(1.0)], None)] * 12)
    assert not verdict.localized
    assert verdict.confidently_wrong_fraction is verdict.truth_probability_mean is None
    assert verdict.steps == 12
