import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.experiments.reliability import (
    Reliability,
    mean_calibration_error,
    pooled,
)
from tests.unit.evaluation.experiments.made_up import claims


def test_claims_that_come_true_as_often_as_claimed_have_no_error() -> None:
    part = claims(*[(0.75, True)] * 3, (0.75, False))
    assert part.expected_calibration_error == pytest.approx(0.0)
    assert part.bins[7].right_share == part.bins[7].mean_probability == 0.75


def test_the_error_is_the_mean_gap_over_all_claims() -> None:
    sure_and_wrong = claims((1.0, False), (0.25, True), (0.25, False), (0.25, False))
    # one claim off by 1, three in a bin of mean 0.25 of which a third came true
    assert sure_and_wrong.expected_calibration_error == pytest.approx((1.0 + 0.25) / 4)


def test_certainty_belongs_to_the_last_bin_and_none_to_the_first() -> None:
    part = claims((1.0, True), (0.0, False), (0.9, True), (1.0 + 1e-15, True))
    assert [each.claims for each in part.bins] == [1, 0, 0, 0, 0, 0, 0, 0, 0, 3]


def test_without_claims_there_is_no_error() -> None:
    assert Reliability().expected_calibration_error is None
    assert mean_calibration_error([Reliability()]) is None


def test_one_part_does_not_make_good_what_another_does_wrong() -> None:
    long, short = claims(*[(0.95, True)] * 99), claims((0.95, False))
    assert mean_calibration_error([long, short, Reliability()]) == pytest.approx((0.05 + 0.95) / 2)
    assert pooled([long, short]).expected_calibration_error == pytest.approx(0.04)


def test_claims_from_a_tenth_on_are_those_of_its_bin_and_above() -> None:
    part = claims((0.95, True), (0.85, False), (0.8, True), (0.3, True)).at_least(8)
    assert (part.claims, part.right, part.mean_probability) == (3, 2, pytest.approx(2.6 / 3))


@given(st.lists(st.lists(st.tuples(st.floats(0, 1), st.booleans())), max_size=4))
def test_pooling_parts_is_taking_all_claims(parts: list[list[tuple[float, bool]]]) -> None:
    together = claims(*(claim for part in parts for claim in part))
    apart = pooled(claims(*part) for part in parts)
    assert apart.claims == together.claims
    assert [each.right for each in apart.bins] == [each.right for each in together.bins]
    assert [each.probability_sum for each in apart.bins] == pytest.approx(
        [each.probability_sum for each in together.bins]
    )
