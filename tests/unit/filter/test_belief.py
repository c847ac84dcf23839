import numpy as np
import pytest

from clustermcl.belief import log_probabilities as belief


@pytest.mark.parametrize("value", [np.nan, -np.inf], ids=["no report", "impossible everywhere"])
def test_what_says_the_same_of_all_places_changes_nothing(value: float) -> None:
    prior = belief.normalised_logs(np.array([0.0, -1.0]))
    np.testing.assert_array_equal(belief.updated(prior, np.full(2, value)), prior)


def test_a_belief_without_mass_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        belief.normalised_logs(np.full(3, -np.inf))
