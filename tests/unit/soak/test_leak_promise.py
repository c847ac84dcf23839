import os

import psutil
import pytest

from tests.soak import leak_promise
from tests.soak.leak_promise import LEAST_SPAN_S, WARM_UP_S, NothingLeaks

ME = psutil.Process(os.getpid())


class Samples:
    """A process whose memory is made up, a sample a minute."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.promise, self._patch = NothingLeaks(), monkeypatch
        self.now_s = ME.create_time()

    def grow(self, minutes: int, mb_per_hour: float, *, leads: bool = False) -> None:
        for minute in range(minutes):
            self.now_s += 60.0
            info = type("Info", (), {"uss": (20.0 + mb_per_hour * minute / 60.0) * 1e6})
            self._patch.setattr(psutil.Process, "memory_full_info", lambda _, i=info: i)
            self._patch.setattr(leak_promise.time, "time", lambda: self.now_s)
            self.promise.sample([("coordinator", ME, leads)])


def test_a_process_that_grows_leaks_and_one_that_rests_does_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    samples = Samples(monkeypatch)
    samples.grow(30, 0.0)
    assert samples.promise.verdict().kept is True
    leaking = Samples(monkeypatch)
    leaking.grow(30, 6.0)
    verdict = leaking.promise.verdict()
    assert verdict.kept is False
    assert list(verdict.figures.values()) == [pytest.approx(6.0)]


def test_growth_during_the_warm_up_and_over_a_short_time_does_not_count(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    samples = Samples(monkeypatch)
    samples.grow(int((WARM_UP_S + LEAST_SPAN_S) / 60.0) - 1, 600.0)
    assert samples.promise.verdict().kept is None


def test_what_a_coordinator_needs_to_lead_is_no_growth(monkeypatch: pytest.MonkeyPatch) -> None:
    samples = Samples(monkeypatch)
    samples.grow(20, 0.0)
    samples.grow(20, 0.0, leads=True)
    assert samples.promise.verdict().kept is True
    assert len(samples.promise.verdict().figures) >= 1
