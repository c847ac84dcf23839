import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.experiments.wilson import wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [  # as statsmodels' proportion_confint(method="wilson") and R's prop.test(correct=FALSE) say
        (20, 20, 0.8389, 1.0),
        (10, 20, 0.2993, 0.7007),
        (0, 10, 0.0, 0.2775),
        (1, 10, 0.0179, 0.4042),
        (39, 40, 0.8712, 0.9956),
    ],
)
def test_intervals_are_those_of_the_tables(
    successes: int, trials: int, low: float, high: float
) -> None:
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(0, 300).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_interval_holds_the_share_and_mirrors(counts: tuple[int, int]) -> None:
    successes, trials = counts
    low, high = wilson_interval(successes, trials)
    assert 0.0 <= low <= high <= 1.0
    if trials:
        assert low - 1e-12 <= successes / trials <= high + 1e-12
    mirrored = wilson_interval(trials - successes, trials)
    assert (1.0 - mirrored.high, 1.0 - mirrored.low) == pytest.approx((low, high))


def test_of_no_trial_nothing_is_known() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize("counts", [(3, 2), (-1, 2)])
def test_impossible_counts_are_refused(counts: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="trials"):
        wilson_interval(*counts)
