import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.belief.pose_tracker import LatencyEstimator

MS, SECOND = 1_000_000, 1_000_000_000


def prompt(clock_ahead_ns: int, seconds: float) -> LatencyEstimator:
    """A robot whose odometry takes 5 ms, 20 times a second."""
    lateness = LatencyEstimator()
    for tick in range(int(seconds * 20)):
        now_ns = tick * 50 * MS
        lateness.on_arrival(now_ns - 5 * MS + clock_ahead_ns, now_ns)
    return lateness


@given(st.integers(-(10**18), 10**18))
def test_delayed_data_is_late_by_the_delay_whatever_the_robots_clock(ahead_ns: int) -> None:
    lateness = prompt(ahead_ns, 30.0)
    assert lateness.on_arrival(30 * SECOND - 5 * MS + ahead_ns, 30 * SECOND) == 0
    assert lateness.on_arrival(30 * SECOND - 5 * MS + ahead_ns, 31 * SECOND) == SECOND


def test_an_outage_of_some_seconds_does_not_change_the_usual_delay() -> None:
    lateness = prompt(0, 30.0)
    assert lateness.on_arrival(30 * SECOND - 5 * MS, 34 * SECOND) == 4 * SECOND
    assert lateness.on_arrival(31 * SECOND - 5 * MS, 34 * SECOND) == 3 * SECOND


def test_the_usual_delay_follows_a_drifting_clock() -> None:
    lateness = LatencyEstimator()
    late_ns = [
        lateness.on_arrival(tick * 50 * MS - tick * 50 * MS // 10_000, tick * 50 * MS)
        for tick in range(20 * 600)
    ]
    assert max(late_ns) <= 2 * MS, "a tenth of a millisecond a second, over at most ten seconds"


@pytest.mark.parametrize("change_ns", [-3600 * SECOND, 7 * SECOND])
def test_a_clock_that_is_set_makes_nothing_late(change_ns: int) -> None:
    lateness = prompt(0, 30.0)
    assert lateness.on_arrival(30 * SECOND + change_ns, 30 * SECOND) == 0
    assert lateness.on_arrival(31 * SECOND + change_ns, 31 * SECOND) == 0
