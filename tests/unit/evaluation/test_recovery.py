import math

import pytest

from evaluation.mcl import Recovery, RecoveryGains

GAINS = RecoveryGains(slow=0.1, fast=0.5)


def after(*likelihoods: float) -> float:
    recovery = Recovery(GAINS)
    for likelihood in likelihoods:
        recovery.on_likelihood(math.log(likelihood))
    return recovery.random_share


def test_nothing_is_random_before_the_first_scan_nor_after_it() -> None:
    assert Recovery(GAINS).random_share == 0.0
    assert after(0.3) == 0.0


def test_while_scans_fit_as_ever_or_better_nothing_is_random() -> None:
    assert after(*[0.3] * 20) == pytest.approx(0.0, abs=1e-12)
    assert after(0.1, 0.2, 0.4, 0.8) == 0.0


def test_the_random_share_is_what_the_fast_average_lacks_of_the_slow_one() -> None:
    assert after(1.0, 0.2) == pytest.approx(1.0 - 0.6 / 0.92)
    assert after(1.0, 0.2, 0.2) == pytest.approx(1.0 - 0.4 / 0.848)


def test_a_scan_that_fits_nowhere_is_no_error() -> None:
    recovery = Recovery(GAINS)
    for log_likelihood in (-1.0, -math.inf, -1e9):
        recovery.on_likelihood(log_likelihood)
    assert recovery.random_share == pytest.approx(1.0 - 0.25 / 0.81)
    never = Recovery(GAINS)
    never.on_likelihood(-math.inf)
    assert 0.0 <= never.random_share <= 1.0
