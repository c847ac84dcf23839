import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from clustermcl.belief import log_probabilities as belief

K = 5
ANY_LOGS = arrays(np.float64, K, elements=st.floats(-700.0, 50.0))


@given(ANY_LOGS, ANY_LOGS)
def test_the_update_is_prior_times_likelihood_normalised(
    log_prior: NDArray[np.float64], log_likelihood: NDArray[np.float64]
) -> None:
    prior = belief.normalised_logs(log_prior)
    expected = belief.normalised_logs(prior + log_likelihood)
    np.testing.assert_allclose(belief.updated(prior, log_likelihood), expected, atol=1e-9)


@given(ANY_LOGS, ANY_LOGS, st.sets(st.integers(0, K - 1), max_size=K - 1))
def test_a_cluster_without_a_report_keeps_its_probability(
    log_prior: NDArray[np.float64], log_likelihood: NDArray[np.float64], missing: set[int]
) -> None:
    prior = belief.normalised_logs(log_prior)
    absent = sorted(missing)
    log_likelihood[absent] = np.nan
    posterior = belief.updated(prior, log_likelihood)
    np.testing.assert_allclose(np.exp(posterior[absent]), np.exp(prior[absent]), atol=1e-12)
    assert np.sum(np.exp(posterior)) == pytest.approx(1.0)


@pytest.mark.parametrize("value", [np.nan, -np.inf], ids=["no report", "impossible everywhere"])
def test_what_says_the_same_of_all_places_changes_nothing(value: float) -> None:
    prior = belief.normalised_logs(np.array([0.0, -1.0]))
    np.testing.assert_array_equal(belief.updated(prior, np.full(2, value)), prior)


def test_a_belief_without_mass_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        belief.normalised_logs(np.full(3, -np.inf))
