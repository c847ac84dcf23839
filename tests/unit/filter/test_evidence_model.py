import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from clustermcl.filter.laser.evidence_model import (
    UsualFit,
    contenders,
    evidence_weight,
    residual,
    short_beam_gain,
    tempered,
    way,
)
from clustermcl.filter.poses import between
from clustermcl.filter.settings import BeliefSettings, SensorSettings

RULES = BeliefSettings(view_distance_m=0.8, view_turn_rad=1.6, evidence_residual=0.5)
EVIDENCE = arrays(np.float64, 5, elements=st.floats(-1e6, 1e6))
ALL = np.ones(5, np.bool_)


def test_differences_to_the_best_are_scaled_and_clusters_without_report_stay() -> None:
    evidence = np.array([-11.0, np.nan, -10.0, -14.0])
    np.testing.assert_allclose(tempered(evidence, ALL[:4], 0.25, 0.0), [-0.25, np.nan, 0.0, -1.0])
    np.testing.assert_array_equal(tempered(evidence, ALL[:4], 1.0, 0.0), evidence + 10.0)
    np.testing.assert_allclose(tempered(evidence, ALL[:4], 0.0, 0.0), [0.0, np.nan, 0.0, 0.0])


def test_differences_within_monte_carlo_error_count_almost_nothing() -> None:
    evidence = -np.array([0.0, 0.003, 0.3, 3.0, 300.0])
    expected = [0.0, 0.003 * 0.003 / 0.303, 0.15, 9.0 / 3.3, 300.0 * 300.0 / 300.3]
    np.testing.assert_allclose(tempered(evidence, ALL, 0.5, 0.3), -0.5 * np.array(expected))


@given(EVIDENCE, st.floats(0.0, 1.0), st.floats(0.0, 2.0))
def test_a_better_fit_never_weighs_less_and_no_fit_weighs_more_than_its_difference(
    evidence: NDArray[np.float64], share: float, noise: float
) -> None:
    reported = tempered(evidence, ALL, share, noise)
    assert np.all(np.diff(reported[np.argsort(evidence)]) >= 0.0)
    assert reported.max() == 0.0
    lost = evidence.max() - evidence
    assert np.all(-reported <= lost * (1.0 + 1e-12))


def test_an_improbable_hypothesis_gains_as_much_as_a_probable_one_would_lose_to_it() -> None:
    evidence, contends = np.array([0.0, -0.3, 5.0]), np.array([True, True, False])
    expected = [0.0, -0.3 * 0.3 / 0.6, 5.0 * 5.0 / 5.3]
    np.testing.assert_allclose(tempered(evidence, contends, 1.0, 0.3), expected)


@given(EVIDENCE, st.floats(0.0, 2.0), st.floats(-1e6, 1e6))
def test_the_gain_of_contenders_does_not_depend_on_other_places(
    evidence: NDArray[np.float64], noise: float, other: float
) -> None:
    contends = np.array([True, True, True, True, False])
    one = tempered(evidence, contends, 0.5, noise)
    evidence[-1] = other
    np.testing.assert_array_equal(tempered(evidence, contends, 0.5, noise)[:-1], one[:-1])


@pytest.mark.parametrize(
    ("probabilities", "expected"),
    [
        ([1.0], [True]),
        ([0.5, 0.5], [True, True]),
        ([0.6, 0.389, 0.011], [True, True, True]),
        ([0.6, 0.391, 0.009], [True, True, False]),
        ([0.6, 0.389, 0.0055, 0.0055], [True, True, True, True]),
        ([0.992, 0.004, 0.004], [True, False, False]),
        ([0.009, 0.1, 0.891], [False, True, True]),
        ([0.005] * 200, [True] * 200),
        ([0.0, 1.0], [False, True]),
    ],
)
def test_contenders_are_the_most_probable_with_99_percent_of_the_belief(
    probabilities: list[float], expected: list[bool]
) -> None:
    """Whatever the sum of all is: of hypotheses without a report nothing is known."""
    with np.errstate(divide="ignore"):
        logs = np.log(probabilities)
    for shift in (0.0, -1000.0):
        assert contenders(logs + shift).tolist() == expected


def test_evidence_weighs_less_the_worse_the_best_place_fits() -> None:
    shares = [evidence_weight(1.0, bad, RULES) for bad in (0.0, 0.25, 0.5, 1.0)]
    assert shares == pytest.approx([1.0, 0.8, 0.5, 0.2])
    assert evidence_weight(0.3, 0.5, RULES) == pytest.approx(0.15)
    assert evidence_weight(0.3, math.nan, RULES) == 0.3, "no beam was weighed"
    literal = BeliefSettings(evidence_residual=math.inf)
    assert evidence_weight(1.0, 9.0, literal) == 1.0


def test_the_residual_is_the_loss_against_beams_that_all_end_on_obstacles() -> None:
    sensor = SensorSettings(hit_weight=0.75, random_weight=0.25, hit_sigma_m=0.15, max_range_m=30.0)
    best = math.log(0.75 / (math.sqrt(2.0 * math.pi) * 0.15) + 0.25 / 30.0)
    assert residual(best, sensor) == 0.0
    assert residual(best - 1.5, sensor) == pytest.approx(1.5)
    assert residual(best + 1e-9, sensor) == 0.0, "rounding"
    assert math.isnan(residual(math.nan, sensor))


def test_the_way_of_a_motion_is_its_distance_and_its_wrapped_turn() -> None:
    before, after = np.array([3.0, 4.0, math.pi - 0.05]), np.array([3.3, 4.4, 0.05 - math.pi])
    assert way(between(before, after)) == pytest.approx((0.5, 0.1))
    assert way(between(after, before)) == pytest.approx((0.5, 0.1))
    assert way(between(before, before)) == (0.0, 0.0)


def fit_after(*scans: float) -> UsualFit:
    """The usual fit after these scans; all are far apart."""
    fit = UsualFit()
    for scan in scans:
        fit = fit.after(scan, 1.0)
    return fit


def test_a_fall_of_the_fit_beyond_its_variation_is_detected_within_two_scans() -> None:
    steady = [3.0, 3.2] * 20
    assert not fit_after(*steady).has_fallen
    assert fit_after(*steady, -2.0, -2.0).has_fallen
    assert not fit_after(*[-10.0, 3.0] * 20, -10.0, -10.0).has_fallen, "among people it varies"


def test_a_fallen_fit_is_reported_until_scans_fit_again_or_it_becomes_usual() -> None:
    fallen = [3.0, 3.2] * 20 + [-5.0] * 5
    assert fit_after(*fallen).has_fallen
    assert not fit_after(*fallen, 3.1).has_fallen
    assert not fit_after(*fallen, *[-5.0] * 5).has_fallen


def test_a_fit_that_falls_slowly_is_not_detected() -> None:
    assert not fit_after(*np.linspace(3.0, -3.0, 400).tolist()).has_fallen


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50), st.floats(0.0, 1.0))
def test_the_usual_fit_stays_finite_for_any_scans(scans: list[float], news: float) -> None:
    fit = UsualFit()
    for scan in scans:
        fit = fit.after(scan, news)
    assert fit.mean is not None
    assert math.isfinite(fit.mean + fit.shortfall)
    assert fit.variance > 0.0


def test_short_beams_gain_where_people_have_stood_before_and_nowhere_else() -> None:
    settings = SensorSettings()
    assert short_beam_gain(0.0, settings) == short_beam_gain(0.01, settings) == 0.0
    assert 1.5 < short_beam_gain(0.1, settings) < short_beam_gain(0.5, settings) < 4.0
