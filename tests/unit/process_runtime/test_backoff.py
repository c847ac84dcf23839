from process_runtime.supervisor import Backoff


def test_each_wait_is_twice_the_one_before_up_to_the_longest() -> None:
    backoff = Backoff(first_s=1.0, longest_s=5.0, settled_s=10.0)
    assert [backoff.after_death(0.1) for _ in range(5)] == [1.0, 2.0, 4.0, 5.0, 5.0]


def test_a_process_that_ran_long_enough_is_restarted_without_backoff() -> None:
    backoff = Backoff(first_s=1.0, longest_s=5.0, settled_s=10.0)
    assert [backoff.after_death(lived_s) for lived_s in (0.1, 0.1, 10.0, 0.1)] == [1, 2, 1, 2]
