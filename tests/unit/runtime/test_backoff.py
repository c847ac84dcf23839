import pytest

from clustermcl.runtime.supervisor import Backoff


def test_restarts_wait_twice_as_long_each_time_up_to_ten_seconds() -> None:
    backoff = Backoff()
    waits_s = [backoff.after_death(0.1) for _ in range(9)]
    assert waits_s == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10.0, 10.0])


def test_a_process_that_ran_for_ten_seconds_is_restarted_at_once() -> None:
    backoff = Backoff()
    waits_s = [backoff.after_death(lived_s) for lived_s in (0.1, 0.1, 10.0, 0.1)]
    assert waits_s == pytest.approx([0.1, 0.2, 0.1, 0.2])
