import pytest

from clustermcl.coordinator.slow_workers import (
    FIRST_PAUSE_NS,
    GIVEN_UP_AFTER,
    LONGEST_PAUSE_NS,
    StragglerPolicy,
)

SECOND = 1_000_000_000


def proven() -> StragglerPolicy:
    """Worker ``slow`` has reported before."""
    policy = StragglerPolicy()
    policy.on_report("slow")
    return policy


def miss(policy: StragglerPolicy, steps: int, at_ns: int = 0) -> list[str]:
    """Worker ``slow`` misses steps that another reports; returns the workers given up with the
    last."""
    given_up: list[str] = []
    for _ in range(steps):
        given_up = policy.on_step_decided({"other"}, {"slow"}, at_ns)
    return given_up


def test_no_step_waits_for_a_worker_that_missed_one_until_it_reports_again() -> None:
    policy = proven()
    assert policy.waits_for("slow")
    assert miss(policy, 1) == []
    assert not policy.waits_for("slow")
    assert policy.waits_for("other")
    policy.on_report("slow")
    assert policy.waits_for("slow")


def test_a_worker_that_misses_three_consecutive_steps_is_given_up() -> None:
    policy = StragglerPolicy()
    assert miss(policy, GIVEN_UP_AFTER - 1) == []
    assert miss(policy, 1) == ["slow"]
    assert not policy.may_work("slow", 0, answers=False)


def test_a_step_in_time_saves_a_worker_and_a_late_report_does_not() -> None:
    late, back = proven(), proven()
    for policy in (late, back):
        miss(policy, GIVEN_UP_AFTER - 1)
        policy.on_report("slow")
    back.on_step_decided({"slow", "other"}, set(), 0)
    assert miss(late, 1) == ["slow"]
    assert miss(back, 1) == []


@pytest.mark.parametrize(
    ("reported", "missing"),
    [
        pytest.param(set(), {"a", "b"}, id="all reports are missing"),
        pytest.param({"a"}, {"a"}, id="it reports one of its jobs"),
    ],
)
def test_a_worker_is_not_late_if_none_or_itself_reports(
    reported: set[str], missing: set[str]
) -> None:
    policy = StragglerPolicy()
    for _ in range(10):
        assert policy.on_step_decided(reported, missing, 0) == []
    assert policy.waits_for("a")


def test_a_frozen_worker_works_again_when_it_answers_and_its_pause_is_over() -> None:
    policy = proven()
    miss(policy, GIVEN_UP_AFTER)
    assert not policy.may_work("slow", FIRST_PAUSE_NS, answers=False)
    assert not policy.may_work("slow", FIRST_PAUSE_NS - 1, answers=True)
    assert policy.may_work("slow", FIRST_PAUSE_NS, answers=True)
    assert policy.waits_for("slow")
    assert policy.may_work("slow", FIRST_PAUSE_NS, answers=False), "it works now"


def test_pauses_double_and_are_short_again_after_good_work() -> None:
    policy, now_ns, pauses_s = proven(), 0, []
    miss(policy, GIVEN_UP_AFTER - 1)
    for _ in range(7):
        assert miss(policy, 1, now_ns) == ["slow"]
        began_ns = now_ns
        while not policy.may_work("slow", now_ns, answers=True):
            now_ns += SECOND
        pauses_s.append((now_ns - began_ns) // SECOND)
    assert pauses_s == [2, 4, 8, 16, 32, 60, LONGEST_PAUSE_NS // SECOND]
    for _ in range(5):
        policy.on_step_decided({"slow", "other"}, set(), now_ns)
    miss(policy, GIVEN_UP_AFTER, now_ns)
    assert policy.may_work("slow", now_ns + FIRST_PAUSE_NS, answers=True)


def test_a_later_worker_of_the_same_name_has_no_history() -> None:
    policy = proven()
    miss(policy, GIVEN_UP_AFTER)
    policy.forget("slow")
    assert policy.may_work("slow", 0, answers=False)
    assert policy.waits_for("slow")


NAMES = [f"liar-{n}" for n in range(60)]


def test_sixty_names_of_one_origin_are_given_up_as_one() -> None:
    policy = StragglerPolicy()
    for step in range(GIVEN_UP_AFTER):
        assert policy.waits_for("liar-7") == (step == 0), "until one of them has missed a step"
        given_up = policy.on_step_decided({"other-0"}, {"liar-0", "liar-1"}, 0)
    assert given_up == ["liar-0", "liar-1"]
    assert not any(policy.may_work(name, FIRST_PAUSE_NS - 1, answers=True) for name in NAMES)
    assert policy.may_work("liar-9", FIRST_PAUSE_NS, answers=True)
    assert not policy.waits_for("liar-9"), "a trial holds up no step"
    policy.on_report("liar-9")
    assert policy.waits_for("liar-9")
    assert policy.waits_for("other-0")


def test_workers_of_one_origin_that_keep_their_jobs_are_not_given_up_with_the_others() -> None:
    policy, late = StragglerPolicy(), {"liar-0", "liar-1"}
    for _ in range(GIVEN_UP_AFTER):
        assert policy.on_step_decided({"other-0"}, late, 0, keep=late) == []
    assert not policy.waits_for("liar-0")
    for _ in range(GIVEN_UP_AFTER):
        given_up = policy.on_step_decided({"other-0"}, late, 0, keep={"liar-0"})
    assert given_up == ["liar-1"]


def test_all_workers_are_trusted_before_the_first_report_except_given_up_ones() -> None:
    policy = StragglerPolicy()
    workers = ["good-0", "good-1", "liar-0", "liar-1"]
    assert policy.trusted(workers) == workers
    policy.give_up("liar-0", SECOND)
    assert policy.trusted(workers) == ["good-0", "good-1"]


def test_workers_of_an_origin_that_has_reported_are_trusted() -> None:
    policy = StragglerPolicy()
    policy.on_report("good-0")
    assert policy.trusted(["good-0", "good-1", "liar-0", "alone"]) == ["good-0", "good-1"]
    policy.give_up("good-1", SECOND)
    assert policy.trusted(["good-0", "good-1", "good-2"]) == ["good-0"], "each has to prove itself"
    policy.on_report("good-2")
    assert policy.trusted(["good-0", "good-1", "good-2"]) == ["good-0", "good-2"]


def test_an_origin_stays_given_up_when_its_worker_returns() -> None:
    policy = StragglerPolicy()
    policy.give_up("liar-0", SECOND)
    policy.forget("liar-0")
    assert not policy.may_work("liar-0", SECOND, answers=True)
