import pytest

from clustermcl.link.health import RATE_OVER_S, HealthReporter
from clustermcl.link.inbox import Inbox
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.health import Health
from clustermcl.runtime.logs import CauseCounter


class Process:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.causes = CauseCounter()
        self.health = HealthReporter("a", "worker", self.causes, Inbox({}), lambda: self.now_s)


def test_rates_are_averages_over_the_last_seconds() -> None:
    process = Process()
    for tick in range(200):  # ten a second for twenty seconds
        process.now_s = 100.0 + tick / 10
        process.health.happened("scans")
    process.now_s = 120.0
    assert process.health.health().rates_per_s == {"scans": pytest.approx(10.0, rel=0.1)}
    process.now_s += 2 * RATE_OVER_S
    assert process.health.health().rates_per_s["scans"] < 5.1
    process.now_s += 2 * RATE_OVER_S
    assert process.health.health().rates_per_s == {"scans": 0.0}
    assert process.health.health().done == {"scans": 200}


def test_ages_are_since_the_last_occurrence() -> None:
    process = Process()
    for now_s, what, times in ((101.0, "scans", 1), (102.0, "steps", 3)):
        process.now_s = now_s
        process.health.happened(what, times)
    process.now_s = 105.0
    health = process.health.health()
    assert health.ages_s == {"scans": 4.0, "steps": 3.0}
    assert (health.done["steps"], health.uptime_s) == (3, 5.0)


def test_health_can_be_read_however_many_sources_are_broken() -> None:
    process = Process()
    process.causes.total["reading refused: outlier in time or place"] = 2
    process.causes.total.update(f"reading refused: broken source {tag}" for tag in range(600))
    health = decode(encode(process.health.health()), Health)
    assert health.dropped["reading refused: outlier in time or place"] == 2
