"""Who is waited for, and who is given up."""

from coordinator.membership.straggler_policy import (
    FIRST_PAUSE_NS,
    FORGOTTEN_AFTER_NS,
    GIVEN_UP_AFTER,
    LONGEST_PAUSE_NS,
    StragglerPolicy,
)

SECOND = 1_000_000_000


def miss(policy: StragglerPolicy, steps: int, at_ns: int = 0) -> list[str]:
    """Worker ``slow`` misses steps that another reports; who is given up with the last."""
    given_up: list[str] = []
    for _ in range(steps):
        given_up = policy.step_decided({"other"}, {"slow"}, at_ns)
    return given_up


def test_who_has_missed_one_step_is_not_waited_for_until_it_speaks_again() -> None:
    policy = StragglerPolicy()
    assert policy.waits_for("slow")
    assert miss(policy, 1) == []
    assert not policy.waits_for("slow")
    assert policy.waits_for("other")
    policy.heard("slow", in_time=False)
    assert policy.waits_for("slow")


def test_who_misses_three_steps_in_a_row_is_given_up() -> None:
    policy = StragglerPolicy()
    assert miss(policy, GIVEN_UP_AFTER - 1) == []
    assert miss(policy, 1) == ["slow"]
    assert not policy.may_work("slow", 0, answers=False)


def test_late_reports_save_nobody_and_one_in_time_does() -> None:
    late, back = StragglerPolicy(), StragglerPolicy()
    for policy, in_time in ((late, False), (back, True)):
        miss(policy, GIVEN_UP_AFTER - 1)
        policy.heard("slow", in_time=in_time)
    assert miss(late, 1) == ["slow"]
    assert miss(back, 1) == []


def test_when_all_are_missing_it_is_nobodys_fault() -> None:
    policy = StragglerPolicy()
    for _ in range(10):
        assert policy.step_decided(set(), {"a", "b"}, 0) == []
    assert policy.waits_for("a")


def test_who_reports_with_one_of_its_jobs_is_not_late_with_the_other() -> None:
    policy = StragglerPolicy()
    for _ in range(10):
        assert policy.step_decided({"a"}, {"a"}, 0) == []
    assert policy.waits_for("a")


def test_a_frozen_worker_works_again_when_it_answers_and_its_pause_is_over() -> None:
    policy = StragglerPolicy()
    miss(policy, GIVEN_UP_AFTER)
    assert not policy.may_work("slow", FIRST_PAUSE_NS, answers=False)
    assert not policy.may_work("slow", FIRST_PAUSE_NS - 1, answers=True)
    assert policy.may_work("slow", FIRST_PAUSE_NS, answers=True)
    assert policy.waits_for("slow")
    assert policy.may_work("slow", FIRST_PAUSE_NS, answers=False), "it works now"


def test_pauses_double_and_are_forgotten_after_long_good_work() -> None:
    policy, now_ns, pauses_s = StragglerPolicy(), 0, []
    for _ in range(7):
        miss(policy, GIVEN_UP_AFTER, now_ns)
        began_ns = now_ns
        while not policy.may_work("slow", now_ns, answers=True):
            now_ns += SECOND
        pauses_s.append((now_ns - began_ns) // SECOND)
    assert pauses_s == [2, 4, 8, 16, 32, 60, LONGEST_PAUSE_NS // SECOND]
    now_ns += FORGOTTEN_AFTER_NS + 1
    miss(policy, GIVEN_UP_AFTER, now_ns)
    assert policy.may_work("slow", now_ns + FIRST_PAUSE_NS, answers=True)


def test_one_of_the_same_name_starts_anew() -> None:
    policy = StragglerPolicy()
    miss(policy, GIVEN_UP_AFTER)
    policy.forget("slow")
    assert policy.may_work("slow", 0, answers=False)
    assert policy.waits_for("slow")
