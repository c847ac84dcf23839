import os
from concurrent.futures import ThreadPoolExecutor

import pytest

from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import Backoff, ChildCount, run_forked, work_without_preempting


def test_restarts_wait_twice_as_long_each_time_until_a_process_ran_for_ten_seconds() -> None:
    backoff = Backoff()
    waits_s = [backoff.after_death(lived_s) for lived_s in [0.1] * 9 + [10.0, 0.1]]
    assert waits_s == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 10.0, 10.0, 0.1, 0.2])


def test_a_process_stopped_while_it_compiled_forks_nothing() -> None:
    """The signal has started a watching thread; a later fork would be refused as a bug."""
    stop, forked = StopFlag(), list[int]()
    stop.set()
    run_forked(ChildCount(3, 3), lambda index, *_: forked.append(index), stop, name="worker")
    assert forked == []


def test_there_is_a_child_for_each_job_and_it_ends_only_after_it_was_idle_for_a_while() -> None:
    count = ChildCount(2, 8)
    assert [count.wanted(jobs, 0.0) for jobs in (0, 1, 3, 6)] == [2, 2, 3, 6]
    assert [count.wanted(2, now_s) for now_s in (1.0, 29.0)] == [6, 6]
    assert count.wanted(5, 29.5) == 6, "one of the six is idle, and may be needed again"
    assert [count.wanted(jobs, 31.0) for jobs in (3, 4, 60)] == [3, 4, 8]


def test_batch_scheduling_applies_to_the_calling_thread_and_may_be_forbidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def policy_after_asking() -> int:
        work_without_preempting()
        return os.sched_getscheduler(0)

    def forbidden(*_: object) -> None:
        raise PermissionError("not here")

    before = os.sched_getscheduler(0)
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(policy_after_asking).result() == os.SCHED_BATCH
    assert os.sched_getscheduler(0) == before
    monkeypatch.setattr(os, "sched_setscheduler", forbidden)
    assert policy_after_asking() == before
