import pytest

from clustermcl.coordinator.placement import RESEND_AFTER_NS, Placement
from clustermcl.coordinator.slow_workers import GIVEN_UP_AFTER
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol import work
from tests.unit.coordinator.reports import cloud_at, searched, tracked

SECOND = 1_000_000_000


def track(cluster: int, step: int = 0) -> work.TrackJob:
    return work.TrackJob(cluster=cluster, start=cloud_at((0.0, 0.0, 0.0), step), exact=False)


def placement(*workers: str) -> Placement:
    made = Placement("coordinator", FilterSettings(), snapshot_every_steps=10)
    for worker in workers:
        made.on_worker_joined(worker)
    return made


def due(made: Placement, now_ns: int) -> list[tuple[str, work.WorkOrder]]:
    return made.orders(term=0, map_digest="map", now_ns=now_ns)


def begun(orders: list[tuple[str, work.WorkOrder]]) -> dict[str, list[str]]:
    return {name: [a.job_id for a in order.begin] for name, order in orders if order.begin}


def follow(made: Placement, orders: list[tuple[str, work.WorkOrder]]) -> None:
    for name, order in orders:
        jobs = (*order.keep, *((a.job_id, a.epoch) for a in order.begin))
        answer = work.OrderAnswer(
            sender=name, order=order.order, jobs=tuple((j, e, 0) for j, e in jobs)
        )
        made.on_order_answer(name, answer)


def tracking(*workers: str, clusters: int = 1) -> Placement:
    """Its workers have confirmed their jobs."""
    made = placement(*workers)
    made.jobs.begin({f"c{n}": track(n) for n in range(clusters)})
    follow(made, due(made, 0))
    return made


@pytest.mark.parametrize("is_answered", [True, False])
def test_an_order_without_answer_or_refused_is_repeated_with_the_same_epoch(
    is_answered: bool,
) -> None:
    made = placement("a")
    made.jobs.begin({"c0": track(0)})
    ((_, first),) = due(made, 0)
    if is_answered:
        jobs = (("c0", first.begin[0].epoch, 0),)
        refusal = work.OrderAnswer(sender="a", order=first.order, jobs=jobs, problem="other map")
        made.on_order_answer("a", refusal)
    assert due(made, RESEND_AFTER_NS - 1) == []
    ((_, again),) = due(made, RESEND_AFTER_NS)
    assert again.order > first.order
    if not is_answered:
        assert again.begin == first.begin


def test_a_new_number_of_particles_reaches_the_worker_and_its_successor() -> None:
    made = tracking("a", "b", clusters=2)
    made.resize({"c0": (500, 30)})
    ((name, order),) = due(made, 1)
    assert (name, order.begin, order.resize) == ("a", (), (("c0", 500, 30),))
    follow(made, [(name, order)])
    assert due(made, 2) == []
    made.on_worker_left("a")
    ((name, order),) = due(made, 3)
    (given,) = order.begin
    assert name == "b"
    assert (given.job.particles, given.job.particles_from) == (500, 30)


def test_a_number_of_particles_that_its_worker_never_received_is_ordered_again() -> None:
    made = tracking("a")
    made.resize({"c0": (500, 30)})
    due(made, 1)  # lost
    before = work.Assignment(job_id="c0", epoch=made.jobs.by_worker()["a"]["c0"], job=track(0, 9))
    made.on_worker_jobs("a", [before], 2)
    ((_, order),) = due(made, 3)
    assert order.resize == (("c0", 500, 30),)


def test_a_worker_that_returns_without_its_jobs_gets_them_again() -> None:
    made = tracking("a")
    made.on_worker_joined("a")
    assert begun(due(made, SECOND)) == {"a": ["c0"]}, "it was restarted"
    made = tracking("a")
    made.repeat_order("a")
    (_, order), *_ = due(made, SECOND)
    made.on_order_answer("a", work.OrderAnswer(sender="a", order=order.order, jobs=()))
    again = due(made, SECOND + RESEND_AFTER_NS)
    assert begun(again) == {"a": ["c0"]}
    follow(made, again)
    assert due(made, 9 * SECOND) == []


def test_a_worker_given_up_before_it_joined_disturbs_no_other() -> None:
    before = tracking("absent")
    made = placement("b")
    made.resume(before.jobs_to_hand_on(), track_again, 0, term=0)
    made.jobs.begin({"c1": track(1)})
    follow(made, due(made, 0))
    for step in range(GIVEN_UP_AFTER):
        made.on_step_decided(["c0", "c1"], ["c0"], (9 + step) * SECOND)
    assert begun(due(made, 20 * SECOND)) == {"b": ["c0"]}


def track_again(_job_id: str) -> work.TrackJob:
    return track(0)


@pytest.mark.parametrize("link_back_every", [100, 6])
def test_silent_shards_move_and_their_worker_that_never_reported_gets_no_job(
    link_back_every: int,
) -> None:
    """Unless their reports may have been lost with the link."""
    made = placement("a-0", "b-0", "b-1")
    jobs = {f"s0.{n}": work.SearchJob(search=0, shard=n, first_step=0) for n in range(6)}
    made.jobs.begin(jobs)
    follow(made, due(made, 0))
    placed = {job_id: made.jobs.shards()[job_id].worker for job_id in jobs}
    silent = {job_id for job_id, worker in placed.items() if worker == "a-0"}
    assert len(silent) == 2
    for step in range(12):
        now_ns = step * SECOND // 2
        for job_id in jobs.keys() - silent:
            made.on_report(searched(job_id, step, {}), in_time=True)
        if step % link_back_every == 5:
            made.on_link_back()
        follow(made, made.orders(term=0, map_digest="map", now_ns=now_ns, newest_step=step))
    at = {made.jobs.shards()[job_id].worker for job_id in silent}
    assert at == ({"b-0", "b-1"} if link_back_every == 100 else {"a-0"})
    assert bool(made.workers["a-0"]) == (link_back_every == 6)


def test_one_worker_of_an_origin_that_never_reported_tries_one_job() -> None:
    made = tracking("good-0", clusters=9)
    made.on_report(tracked("c0", 1, 0.1, (1.0, 2.0, 0.0)), in_time=True)
    made.jobs.step_applied(1)
    for n in range(60):
        made.on_worker_joined(f"new-{n}")
    follow(made, due(made, SECOND))
    (tried,) = [jobs for name, jobs in made.workers.items() if name != "good-0" and jobs]
    assert len(tried) == 1
    assert made.waits_for(tried[0]), "a healthy one reports in time"
    assert made.jobs.placed_ns(tried[0]) == 0, "no step waits longer for it than its deadline"
    assert due(made, 2 * SECOND) == []
    made.on_report(tracked(tried[0], 2, 0.1, (1.0, 2.0, 0.0)), in_time=True)
    follow(made, due(made, 3 * SECOND))
    assert len([jobs for jobs in made.workers.values() if jobs]) == 9, "all of them are trusted"


def test_a_worker_that_is_asked_for_its_state_gets_no_order_before_its_answer() -> None:
    made = placement()
    made.on_worker_joined("a", silent_until_ns=SECOND)
    made.jobs.begin({"c0": track(0)})
    assert due(made, SECOND - 1) == []
    made.on_worker_jobs("a", [], 0)
    assert begun(due(made, 1)) == {"a": ["c0"]}


def test_one_worker_has_all_jobs_of_a_lone_cluster_and_the_other_stands_by() -> None:
    made = placement("a", "b")
    made.jobs.begin({"elsewhere": work.ElsewhereJob(first_step=0), "c0": track(0), "c1": track(1)})
    follow(made, due(made, 0))
    assert all(made.workers.values())
    made.jobs.end(["c0"])
    follow(made, due(made, 1))
    assert sorted(made.workers.values()) == [(), ("elsewhere", "c1")]
    assert due(made, 9 * SECOND) == [], "it stays so"
    (home,) = [name for name, jobs in made.workers.items() if jobs]
    made.on_worker_left(home)
    (other,) = begun(due(made, 10 * SECOND)).values()
    assert sorted(other) == ["c1", "elsewhere"]


def test_no_step_waits_for_a_silent_worker_with_a_search_which_keeps_its_jobs() -> None:
    made = tracking("a", "b", clusters=2)
    made.jobs.begin({"s0.0": work.SearchJob(search=0, shard=0, first_step=0)})
    follow(made, due(made, 0))
    (silent,) = (name for name, jobs in made.workers.items() if "s0.0" in jobs)
    mine, others = (
        [job_id for job_id in ("c0", "c1") if (job_id in made.workers[silent]) == is_mine]
        for is_mine in (True, False)
    )
    for step in range(2 * GIVEN_UP_AFTER):
        made.on_step_decided([*mine, *others, "s0.0"], mine, (9 + step) * SECOND)
    assert not made.waits_for(mine[0])
    assert {*mine, "s0.0"} <= set(made.workers[silent])
    made.jobs.begin({f"d{n}": track(n) for n in range(9)})
    follow(made, due(made, 20 * SECOND))
    assert {*mine, "s0.0"} == set(made.workers[silent]), "nor does it get others"
