import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clustermcl.filter.arrays import LogWeights
from clustermcl.filter.log_weights import multiplied, weights_and_ess

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
def test_weights_times_likelihoods_are_scaled_to_sum_to_n(
    log_weights: LogWeights, likelihood: float, exponent: float
) -> None:
    count = len(log_weights)
    fit, penalty = np.linspace(0.0, 1.0, count) + likelihood, np.linspace(-2.0, 0.0, count)
    products = np.exp(log_weights + exponent * (fit - likelihood) + penalty)
    after, total = multiplied(log_weights, fit, exponent, penalty)
    assert total == pytest.approx(np.log(products.sum()) + exponent * likelihood, abs=1e-9)
    np.testing.assert_allclose(np.exp(after), products / products.mean(), rtol=1e-9)


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
