"""Laws of weights in logarithms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from particle_filter.arrays import LogWeights
from particle_filter.log_weights import log_sum, multiplied, normalised_weights, weights_and_ess

finite = arrays(np.float64, st.integers(1, 20), elements=st.floats(-50, 50))
NOTHING = np.full(4, -np.inf)


@given(log_weights=finite, offset=st.floats(-1e5, 1e5))
def test_weights_and_sample_size_follow_their_formulas_whatever_the_common_offset(
    log_weights: LogWeights, offset: float
) -> None:
    expected = np.exp(log_weights) / np.exp(log_weights).sum()
    weights, size = weights_and_ess(log_weights + offset)
    np.testing.assert_allclose(weights, expected, rtol=1e-8)
    assert size == pytest.approx(1.0 / (expected**2).sum(), rel=1e-8)


@given(log_weights=finite, likelihood=st.floats(-1e3, 1e3), exponent=st.floats(0.0, 1.0))
def test_products_are_summed_and_scaled_to_their_number(
    log_weights: LogWeights, likelihood: float, exponent: float
) -> None:
    count = len(log_weights)
    fit, penalty = np.linspace(0.0, 1.0, count) + likelihood, np.linspace(-2.0, 0.0, count)
    products = np.exp(log_weights + exponent * (fit - likelihood) + penalty)
    after, total = multiplied(log_weights, fit, exponent, penalty)
    assert total == pytest.approx(np.log(products.sum()) + exponent * likelihood, abs=1e-9)
    np.testing.assert_allclose(np.exp(after), products / products.mean(), rtol=1e-9)


@given(log_weights=finite, offset=st.floats(-1e5, 1e5))
def test_the_sum_of_weights_is_that_of_their_exponentials(
    log_weights: LogWeights, offset: float
) -> None:
    expected = float(np.log(np.exp(log_weights).sum())) + offset
    assert log_sum(log_weights + offset) == pytest.approx(expected, abs=1e-8)
    assert log_sum(NOTHING) == log_sum(NOTHING[:0]) == -np.inf


def test_likelihoods_that_underflow_are_still_distinguished() -> None:
    log_weights = np.log(1e-300) * np.array([3.0, 2.0, 2.0])
    np.testing.assert_allclose(normalised_weights(log_weights), [0.0, 0.5, 0.5], atol=1e-300)
    after, total = multiplied(np.zeros(3), log_weights, 1.0, np.zeros(3))
    assert total == pytest.approx(np.log(2.0) + 2.0 * np.log(1e-300))
    np.testing.assert_allclose(normalised_weights(after), [0.0, 0.5, 0.5], atol=1e-300)


def test_a_zero_weight_takes_no_share() -> None:
    log_weights = np.array([-np.inf, 0.0, 0.0])
    weights, size = weights_and_ess(log_weights)
    np.testing.assert_array_equal(weights, [0.0, 0.5, 0.5])
    assert size == pytest.approx(2.0)


@pytest.mark.parametrize("nothing", [NOTHING, np.empty(0)])
def test_weights_of_zero_cannot_be_normalised(nothing: LogWeights) -> None:
    with pytest.raises(ValueError, match="no weight is above zero"):
        weights_and_ess(nothing)
    with pytest.raises(ValueError, match="no weight is above zero"):
        multiplied(nothing, np.zeros(len(nothing)), 1.0, np.zeros(len(nothing)))


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_infinite_and_nan_weights_are_refused(bad: float) -> None:
    log_weights = np.array([0.0, bad])
    with pytest.raises(ValueError, match="log-weight"):
        weights_and_ess(log_weights)
    with pytest.raises(ValueError, match="log-weight"):
        multiplied(np.zeros(2), log_weights, 1.0, np.zeros(2))
