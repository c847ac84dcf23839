import pytest

from zenoh_link.health import RATE_OVER_S, Activity


def test_rates_are_averages_over_the_last_seconds() -> None:
    activity = Activity(100.0)
    for tick in range(200):  # ten a second for twenty seconds
        activity.happened("scans", 100.0 + tick / 10)
    assert activity.rates_per_s(120.0) == {"scans": pytest.approx(10.0, rel=0.1)}
    assert activity.rates_per_s(120.0 + 2 * RATE_OVER_S)["scans"] < 5.1
    assert activity.rates_per_s(120.0 + 4 * RATE_OVER_S) == {"scans": 0.0}
    assert activity.done == {"scans": 200}


def test_ages_are_since_the_last_occurrence() -> None:
    activity = Activity(0.0)
    activity.happened("scans", 1.0)
    activity.happened("steps", 2.0, times=3)
    assert activity.ages_s(5.0) == {"scans": 4.0, "steps": 3.0}
    assert activity.done["steps"] == 3
    assert activity.uptime_s(5.0) == 5.0


def test_nothing_grows_with_time() -> None:
    activity = Activity(0.0)
    for second in range(10_000):
        activity.happened("scans", float(second))
    assert len(activity._past) < 2 * RATE_OVER_S
