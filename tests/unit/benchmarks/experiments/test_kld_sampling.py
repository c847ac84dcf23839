import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.experiments.baselines import KLD_BIN_M, KLD_BIN_RAD, sufficient_particles


def spread(sigma_m: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    return rng.normal(0.0, 1.0, (2000, 3)) * np.array([sigma_m, sigma_m, 0.05])


def test_the_number_is_that_of_the_formula() -> None:
    """Two occupied bins: k - 1 = 1, so (1 / 2e) (1 - 2/9 + sqrt(2/9) z)^3."""
    two_bins = np.array([[0.05, 0.05, 0.01], [0.15, 0.05, 0.01]])
    expected = 1 / 0.1 * (1 - 2 / 9 + (2 / 9) ** 0.5 * 2.326) ** 3
    assert sufficient_particles(two_bins, 0.05, 1, 10_000) == int(np.ceil(expected))


def test_a_wide_cloud_needs_more_than_a_narrow_one() -> None:
    counts = [sufficient_particles(spread(s), 0.05, 1, 10**6) for s in (0.02, 0.2, 1.0)]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]


@given(st.floats(0.001, 5.0), st.floats(0.001, 0.9))
def test_the_bounds_hold(sigma_m: float, error: float) -> None:
    assert 100 <= sufficient_particles(spread(sigma_m), error, 100, 500) <= 500


def test_bins_count_that_are_apart_in_anything() -> None:
    bins = np.array(np.meshgrid(range(7), range(5), range(3))).reshape(3, -1).T
    poses = (bins + 0.5) * np.array([KLD_BIN_M, KLD_BIN_M, KLD_BIN_RAD])
    k = 7 * 5 * 3 - 1
    expected = k / 0.1 * (1 - 2 / (9 * k) + (2 / (9 * k)) ** 0.5 * 2.326) ** 3
    assert sufficient_particles(poses, 0.05, 1, 10**6) == int(np.ceil(expected))
