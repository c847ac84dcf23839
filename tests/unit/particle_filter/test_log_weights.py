"""Laws of weights in logarithms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from particle_filter.arrays import LogWeights
from particle_filter.log_weights import effective_sample_size, log_sum, normalised

finite = arrays(np.float64, st.integers(1, 20), elements=st.floats(-50, 50))
NOTHING = np.full(4, -np.inf)


@given(log_weights=finite, offset=st.floats(-1e5, 1e5))
def test_weights_sum_to_one_whatever_their_common_offset(
    log_weights: LogWeights, offset: float
) -> None:
    weights = normalised(log_weights + offset)
    assert weights.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(weights, normalised(log_weights), rtol=1e-8)


@given(log_weights=finite)
def test_the_sum_is_the_logarithm_of_the_sum(log_weights: LogWeights) -> None:
    assert log_sum(log_weights) == pytest.approx(np.log(np.exp(log_weights).sum()), abs=1e-12)


@given(log_weights=finite, data=st.data())
def test_order_does_not_matter(log_weights: LogWeights, data: st.DataObject) -> None:
    order = data.draw(st.permutations(range(len(log_weights))))
    shuffled = log_weights[order]
    assert log_sum(shuffled) == pytest.approx(log_sum(log_weights), abs=1e-12)
    np.testing.assert_allclose(normalised(shuffled), normalised(log_weights)[order])
    assert effective_sample_size(shuffled) == pytest.approx(effective_sample_size(log_weights))


@given(log_weights=finite)
def test_the_effective_sample_size_is_between_one_and_all(log_weights: LogWeights) -> None:
    size = effective_sample_size(log_weights)
    assert 1.0 - 1e-9 <= size <= len(log_weights) + 1e-9
    assert effective_sample_size(np.zeros(7)) == pytest.approx(7.0)


def test_likelihoods_that_underflow_are_still_told_apart() -> None:
    log_weights = np.log(1e-300) * np.array([3.0, 2.0, 2.0])
    np.testing.assert_allclose(normalised(log_weights), [0.0, 0.5, 0.5], atol=1e-300)
    assert log_sum(log_weights) == pytest.approx(np.log(2.0) + 2.0 * np.log(1e-300))


def test_a_zero_weight_takes_no_share() -> None:
    log_weights = np.array([-np.inf, 0.0, 0.0])
    np.testing.assert_array_equal(normalised(log_weights), [0.0, 0.5, 0.5])
    assert effective_sample_size(log_weights) == pytest.approx(2.0)
    assert log_sum(log_weights) == pytest.approx(np.log(2.0))


@pytest.mark.parametrize("nothing", [NOTHING, np.empty(0)])
def test_nothing_sums_to_zero_and_cannot_be_normalised(nothing: LogWeights) -> None:
    assert log_sum(nothing) == -np.inf
    assert effective_sample_size(nothing) == 0.0
    with pytest.raises(ValueError, match="no weight is above zero"):
        normalised(nothing)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_weight_is_refused(bad: float) -> None:
    for function in (log_sum, normalised, effective_sample_size):
        with pytest.raises(ValueError, match="log-weight"):
            function(np.array([0.0, bad]))
