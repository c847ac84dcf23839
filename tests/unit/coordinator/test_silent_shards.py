from clustermcl.coordinator import slow_workers
from clustermcl.coordinator.jobs import PlacedJob
from clustermcl.protocol.work import SearchJob

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


def test_a_shard_that_is_silent_while_others_report_is_given_up() -> None:
    search = Search()
    assert search.passes(slow_workers.SHORTEST_NS // TICK_NS, "s0.0", "s0.1") == []
    assert search.passes(slow_workers.STEPS, "s0.0", "s0.1")[0] == "s0.2"


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


def test_a_shard_that_waits_for_a_worker_is_not_given_up() -> None:
    search = Search()
    search.shards["s0.2"].worker = None
    assert search.passes(100, "s0.0", "s0.1") == []


def test_ended_shards_are_forgotten() -> None:
    search = Search()
    search.passes(slow_workers.SHORTEST_NS // TICK_NS, "s0.0", "s0.1")
    shards, search.shards = search.shards, {}
    search.passes(1)
    search.shards = shards
    assert search.passes(2) == []
