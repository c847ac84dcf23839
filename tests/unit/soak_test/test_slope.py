import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soak_test.slope import robust_slope


def life(
    seconds: float, per_hour: float, *, noise: float = 0.0, begin_s: float = 0.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    times_s = np.arange(begin_s, begin_s + seconds, 3.0)
    values = 50.0 + times_s * per_hour / 3600.0
    return times_s, values + noise * np.random.default_rng(seed).standard_normal(len(times_s))


@settings(deadline=None)  # 20,000 pairs each
@given(st.floats(-100.0, 100.0))
def test_a_straight_line_has_its_slope_without_error(per_hour: float) -> None:
    slope = robust_slope([life(300.0, per_hour)])
    assert slope is not None
    assert slope.per_hour == pytest.approx(per_hour, abs=1e-6)
    assert slope.standard_error == pytest.approx(0.0, abs=1e-6)


def test_lives_that_begin_at_other_levels_do_not_look_like_growth() -> None:
    lives = []
    for number in range(5):
        times_s, values = life(300.0, 0.0, begin_s=400.0 * number)
        lives.append((times_s, values + 20.0 * number))
    slope = robust_slope(lives)
    assert slope is not None
    assert slope.per_hour == pytest.approx(0.0)


def test_some_wild_samples_change_nothing() -> None:
    times_s, values = life(1200.0, 6.0)
    values[::10] += 500.0
    slope = robust_slope([(times_s, values)])
    assert slope is not None
    assert slope.per_hour == pytest.approx(6.0, abs=0.1)


def test_the_error_is_about_as_large_as_estimates_scatter() -> None:
    slopes = [robust_slope([life(600.0, 0.0, noise=1.0, seed=seed)]) for seed in range(40)]
    estimates = np.array([slope.per_hour for slope in slopes if slope])
    errors = np.array([slope.standard_error for slope in slopes if slope])
    # The scatter of 40 estimates is itself known to 11 %; a jackknife over ten blocks to 25 %.
    assert np.median(errors) == pytest.approx(estimates.std(), rel=0.5)


@pytest.mark.parametrize("lives", [[], [life(30.0, 1.0)], [(np.zeros(50), np.zeros(50))]])
def test_of_too_few_samples_nothing_is_said(
    lives: list[tuple[np.ndarray, np.ndarray]],
) -> None:
    assert robust_slope(lives) is None
