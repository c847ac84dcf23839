import math

import pytest

from coordinator.pose.odometry_history import KEPT_NS, OdometryHistory
from protocol.message import PoseTuple

SECOND = 1_000_000_000


def driven(seconds: int, rate_hz: int = 10) -> OdometryHistory:
    """Half a metre a second along x."""
    history = OdometryHistory()
    for tick in range(seconds * rate_hz + 1):
        history.add(tick * SECOND // rate_hz, (0.5 * tick / rate_hz, 0.0, 0.0))
    return history


def pose_at(history: OdometryHistory, stamp_ns: int | None) -> PoseTuple | None:
    found = history.at(stamp_ns)
    return found[1] if found else None


def test_before_the_first_odometry_nothing_is_known() -> None:
    assert OdometryHistory().at(None) is None
    assert OdometryHistory().oldest_ns is None


@pytest.mark.parametrize("rate_hz", [1, 10, 333])
def test_odometry_is_known_at_any_time_of_the_last_seconds(rate_hz: int) -> None:
    history = driven(4, rate_hz)
    for at_s in (0.0, 0.05, 1.234, 3.999):
        assert pose_at(history, int(at_s * SECOND)) == pytest.approx((0.5 * at_s, 0.0, 0.0))


def test_now_and_later_is_the_newest() -> None:
    history = driven(3)
    assert history.at(None) == history.at(9 * SECOND) == (3 * SECOND, (1.5, 0.0, 0.0))


def test_a_little_before_the_oldest_is_the_oldest_and_long_before_is_not_known() -> None:
    history = driven(20)
    oldest_ns = 20 * SECOND - KEPT_NS
    assert history.oldest_ns == oldest_ns
    assert history.at(oldest_ns - SECOND // 2) == history.at(oldest_ns)
    assert history.at(oldest_ns - 2 * SECOND) is None


def test_it_turns_the_short_way_round() -> None:
    history = OdometryHistory()
    history.add(0, (0.0, 0.0, 3.0))
    history.add(SECOND, (0.0, 0.0, -3.0))
    halfway = pose_at(history, SECOND // 2)
    assert halfway is not None
    assert abs(halfway[2]) == pytest.approx(math.pi)


def test_a_clock_that_was_set_back_begins_anew() -> None:
    history = driven(4)
    history.add(0, (7.0, 0.0, 0.0))
    assert (history.oldest_ns, pose_at(history, None)) == (0, (7.0, 0.0, 0.0))
