import pytest

from clustermcl.coordinator import slow_workers
from clustermcl.coordinator.jobs import PlacedJob
from clustermcl.coordinator.slow_workers import (
    FIRST_PAUSE_NS,
    GIVEN_UP_AFTER,
    LONGEST_PAUSE_NS,
    StragglerPolicy,
)
from clustermcl.protocol.work import SearchJob

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


def test_three_missed_steps_give_a_worker_up_unless_one_in_time_saves_it() -> None:
    late, back = proven(), proven()
    for policy in (late, back):
        miss(policy, GIVEN_UP_AFTER - 1)
        policy.on_report("slow")
    back.on_step_decided({"slow", "other"}, set(), 0)
    assert miss(late, 1) == ["slow"], "a late report does not save it"
    assert not late.may_work("slow", 0, answers=False)
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


def test_a_later_worker_of_the_same_name_has_no_history_but_its_origin_has() -> None:
    policy = proven()
    miss(policy, GIVEN_UP_AFTER)
    policy.give_up("liar-0", SECOND)
    for worker in ("slow", "liar-0"):
        policy.forget(worker)
    assert policy.may_work("slow", 0, answers=False)
    assert policy.waits_for("slow")
    assert not policy.may_work("liar-0", SECOND, answers=True)


TICK_NS = 500_000_000


class Search:
    """Three shards at workers of their own; ``s0.2`` is silent by default."""

    def __init__(self) -> None:
        self.policy, self.now_ns, self.step = slow_workers.SilentShards(), 0, 0
        self.shards = {
            f"s0.{n}": PlacedJob(
                SearchJob(search=0, shard=n, first_step=0), epoch=1, worker=f"w{n}"
            )
            for n in range(3)
        }

    def passes(self, ticks: int, *reporting: str) -> list[str]:
        """Time passes, with a step and reports each half second; what is given up."""
        given_up: list[str] = []
        for _ in range(ticks):
            self.now_ns += TICK_NS
            given_up += self.policy.given_up(self.shards, self.step, self.now_ns)
            for job_id in reporting:
                self.policy.on_report(job_id, self.step)
            self.step += 1
        return given_up


def test_a_shard_may_take_a_multiple_of_the_others_first_step() -> None:
    search, took = Search(), 20
    assert search.passes(took) == []
    later = (slow_workers.TIMES_THE_OTHERS - 1) * took
    assert search.passes(later - 2, "s0.0", "s0.1") == []
    assert search.passes(8, "s0.0", "s0.1")[0] == "s0.2"


def test_a_shard_that_reports_sometimes_is_kept() -> None:
    search = Search()
    for _ in range(20):
        assert search.passes(slow_workers.STEPS - 1, "s0.0", "s0.1") == []
        assert search.passes(1, "s0.0", "s0.1", "s0.2") == []


def test_shards_that_are_all_silent_are_given_up_after_a_time_that_doubles() -> None:
    search = Search()
    first = slow_workers.LONGEST_NS // TICK_NS
    assert search.passes(first) == []
    assert search.passes(1) == ["s0.0", "s0.1", "s0.2"]
    for shard in search.shards.values():
        shard.epoch, shard.worker = 2, "another"
    assert search.passes(2 * first - 1) == []
    assert "s0.0" in search.passes(3)


def test_no_report_is_due_while_the_robot_stands() -> None:
    search = Search()
    search.passes(1, "s0.0", "s0.1", "s0.2")
    step = search.step = 0
    for _ in range(3 * slow_workers.LONGEST_NS // TICK_NS):
        assert search.passes(1) == []
        search.step = step


def test_time_in_which_the_process_was_stopped_does_not_count() -> None:
    search = Search()
    search.passes(slow_workers.SHORTEST_NS // TICK_NS, "s0.0", "s0.1")
    search.now_ns += slow_workers.LONGEST_NS
    search.policy.forgive()
    assert search.passes(2) == []


def test_a_shard_without_a_worker_or_of_an_earlier_search_is_not_given_up() -> None:
    search = Search()
    search.passes(slow_workers.SHORTEST_NS // TICK_NS, "s0.0", "s0.1")
    shards, search.shards = search.shards, {}
    search.passes(1)
    search.shards = shards
    assert search.passes(2) == []
    search.shards["s0.2"].worker = None
    assert search.passes(100, "s0.0", "s0.1") == []
