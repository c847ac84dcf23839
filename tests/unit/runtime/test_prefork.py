from clustermcl.runtime.stop import StopFlag
from clustermcl.runtime.supervisor import ChildCount, run_forked


def test_a_process_stopped_while_it_compiled_forks_nothing() -> None:
    """The signal has started a watching thread; a later fork would be refused as a bug."""
    stop = StopFlag()
    stop.set()
    forked: list[int] = []
    run_forked(
        ChildCount(3, 3), lambda index, _stop, _jobs: forked.append(index), stop, name="worker"
    )
    assert forked == []


def test_there_is_a_child_for_each_job_within_the_limits() -> None:
    count = ChildCount(2, 4)
    assert [count.wanted(jobs, 0.0) for jobs in (0, 1, 3, 4, 60)] == [2, 2, 3, 4, 4]


def test_children_end_only_after_they_were_not_needed_for_a_while() -> None:
    count = ChildCount(2, 8)
    assert count.wanted(6, 0.0) == 6
    assert [count.wanted(2, now_s) for now_s in (1.0, 29.0)] == [6, 6]
    assert count.wanted(5, 29.5) == 6, "one of the six is idle, and may be needed again"
    assert count.wanted(3, 31.0) == 3
    assert count.wanted(4, 32.0) == 4


def test_a_fixed_number_of_children_stays() -> None:
    count = ChildCount(3, 3)
    assert [count.wanted(jobs, 100.0 * jobs) for jobs in (0, 12, 0)] == [3, 3, 3]
