import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights
from clustermcl.filter.log_weights import multiplied, normalised_weights, weights_and_ess
from clustermcl.filter.resampling import optimal_resampling, resample, systematic
from clustermcl.filter.slices import finished
from tests.unit.filter import naive

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


log_weights = arrays(
    np.float64, st.integers(1, 30), elements=st.one_of(st.floats(-20, 20), st.just(-np.inf))
).filter(lambda values: bool(np.isfinite(values).any()))


def test_resampling_is_unbiased() -> None:
    """Copies average to count times weight, and vary no more than multinomial ones would.

    Their mean over 3,000 runs is known to that deviation; beyond 5.5 of them is a false alarm in
    4e-8, for 20 particles 8e-7.
    """
    rng = np.random.default_rng(11)
    log_weights, count, runs = rng.normal(size=20), 25, 3000
    total = np.zeros(20)
    for _ in range(runs):
        total += np.bincount(resample(log_weights, count, rng), minlength=20)
    weights = normalised_weights(log_weights)
    deviation = np.sqrt(count * weights * (1 - weights) / runs)
    assert (np.abs(total / runs - count * weights) < 5.5 * deviation).all()


@given(
    weights=arrays(np.float64, st.integers(1, 20), elements=st.floats(0.0, 1.0)),
    count=st.integers(1, 40),
    offset=st.floats(0.0, 0.999),
)
def test_the_kernel_agrees_with_the_naive_search(
    weights: NDArray[np.float64], count: int, offset: float
) -> None:
    weights[0] += 1.0
    weights /= weights.sum()
    positions = np.arange(count) + offset
    found, expected = systematic(weights, count, offset), naive.pick(weights, positions)
    # A position on the very border of two weights may round to either side.
    line = np.cumsum(weights) * count
    border = np.abs(line[:, np.newaxis] - positions).min(axis=0) < 1e-9
    np.testing.assert_array_equal(found[~border], expected[~border])


@pytest.mark.parametrize("ending", [[], [0.0], [0.0, 0.0]])
def test_a_position_beyond_the_weights_draws_the_last_weighted_particle(
    ending: list[float],
) -> None:
    weights = np.array([0.3, 0.6, *ending])  # rounding leaves them short of one, here by much
    assert systematic(weights, 2, 0.95).tolist() == [1, 1]


def test_invalid_weights_and_counts_are_refused() -> None:
    for weights, count, problem in ((NOTHING, 3, "no weight"), (np.zeros(3), 0, "count")):
        with pytest.raises(ValueError, match=problem):
            resample(weights, count, np.random.default_rng(0))


def test_thinning_keeps_heavy_particles_and_the_sum_of_weights() -> None:
    rng = np.random.default_rng(0)
    log_weights = rng.normal(0.0, 3.0, 1000) + 700.0
    chosen, after = finished(optimal_resampling(log_weights, 100, rng))
    assert len(np.unique(chosen)) == 100
    assert np.all(np.diff(chosen) > 0)
    assert np.logaddexp.reduce(after) == pytest.approx(np.logaddexp.reduce(log_weights))
    light = after.min()
    heavy = log_weights > light + 1e-9
    assert set(np.flatnonzero(heavy)) <= set(chosen.tolist())
    np.testing.assert_array_equal(after[np.isin(chosen, np.flatnonzero(heavy))], log_weights[heavy])
    np.testing.assert_allclose(after[~np.isin(chosen, np.flatnonzero(heavy))], light)


def test_thinning_is_right_on_average_for_every_particle() -> None:
    log_weights = np.log(np.array([5.0, 1.0, 0.5, 0.25, 0.25, 3.0]))
    total = np.zeros(6)
    for seed in range(4000):
        chosen, after = finished(optimal_resampling(log_weights, 3, np.random.default_rng(seed)))
        total[chosen] += np.exp(after)
    # The lightest is drawn 500 times or so of 4,000: six standard deviations are a quarter.
    np.testing.assert_allclose(total / 4000, np.exp(log_weights), rtol=0.25)
