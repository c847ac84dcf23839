from collections.abc import Mapping

from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.coordinator.jobs import AWAITED_NS, Jobs, balanced
from clustermcl.coordinator.placement import Placement
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.work import Assignment, ElsewhereJob, SearchJob, TrackJob
from tests.unit.coordinator.reports import cloud_at, elsewhere, searched, tracked

TRACK = TrackJob(cluster=0, start=cloud_at((0.0, 0.0, 0.0), 0), exact=False)
SEARCH = SearchJob(search=0, shard=0, first_step=0)
TERM = 0
"""Of a coordinator that hands its jobs on."""


def jobs_of(worker: str, *job_ids: str, term: int = 0) -> Jobs:
    made = Jobs()
    made.begin(dict.fromkeys(job_ids, TRACK))
    made.move(dict.fromkeys(job_ids, worker), term, now_ns=1)
    return made


def handed_on(jobs: Jobs, *present: str) -> Jobs:
    """The jobs as the next coordinator has them."""
    made = Placement("c", FilterSettings(), 10)
    for worker in present:
        made.on_worker_joined(worker)
    made.resume(jobs, lambda _: TRACK, 0, TERM)
    return made.jobs


def test_an_epoch_exceeds_all_epochs_of_earlier_terms() -> None:
    made = jobs_of("a", "c0", term=70)
    assert made.by_worker() == {"a": {"c0": 71}}
    made.move({"c0": "b"}, 70, now_ns=2)
    assert made.by_worker() == {"b": {"c0": 72}}
    report = tracked("c0", 1, 0.1, (0.0, 0.0, 0.0), epoch=72)
    assert made.refusal_of(replace(report, epoch=71), "b") == "report of an old epoch"
    assert made.refusal_of(report, "b") is None


def test_a_step_waits_longer_for_a_job_until_its_worker_has_reported_in_time() -> None:
    made = jobs_of("a", "c0")
    report = tracked("c0", 1, 0.1, (0.0, 0.0, 0.0))
    made.on_report(report, in_time=False)
    assert made.placed_ns("c0") == 1
    made.on_report(report, in_time=True)
    assert made.placed_ns("c0") == 0


def test_a_search_may_move_before_its_first_report_and_a_cluster_after_its_snapshot() -> None:
    made = Jobs()
    made.begin({"s0.0": SEARCH, "c0": TRACK})
    assert made.may_move("s0.0")
    made.on_report(searched("s0.0", 0, {}), in_time=True)
    made.on_report(tracked("c0", 1, 0.1, (0.0, 0.0, 0.0)), in_time=True)
    assert not made.may_move("s0.0")
    assert not made.may_move("c0"), "only its worker has the reports before its snapshot"
    made.step_applied(TRACK.start.step)
    assert made.may_move("c0")


def test_the_elsewhere_job_continues_after_the_last_applied_step() -> None:
    made = Jobs()
    made.begin({"e0": ElsewhereJob(first_step=3)})
    made.on_report(elsewhere(7, -2.0), in_time=True)
    assert made.assignment("e0").job == ElsewhereJob(first_step=3)
    made.step_applied(6)
    assert made.assignment("e0").job == ElsewhereJob(first_step=7)
    ahead = Assignment(job_id="e0", epoch=9, job=ElsewhereJob(first_step=9))
    made.held("w1", [ahead], 0)
    assert made.assignment("e0").job == ElsewhereJob(first_step=7), "no job has applied 7 and 8"
    assert made.may_move("e0")


def test_absent_workers_keep_their_jobs_for_a_while_after_a_take_over() -> None:
    made = handed_on(jobs_of("a", "c0"), "b")
    made.give_up_awaited(AWAITED_NS - 1)
    assert "a" in made.by_worker()
    made.give_up_awaited(AWAITED_NS)
    assert set(made.by_worker()) == {None}
    made = handed_on(jobs_of("a", "c0"))
    del made.awaited_until_ns["a"]  # it appears in time: as `Placement` does
    made.give_up_awaited(10 * AWAITED_NS)
    assert made.by_worker() == {"a": {"c0": 1}}


def test_a_worker_keeps_its_jobs_unless_they_ended_or_were_given_away() -> None:
    made = handed_on(jobs_of("a", "c0", "c1"))
    held = [Assignment(job_id=i, epoch=e, job=TRACK) for i, e in (("c0", 9), ("c1", 1), ("c7", 9))]
    kept = made.held("b", held, now_ns=2)
    assert kept == held[:1], "c1 was given away with epoch 2, and c7 is unknown"
    assert made.by_worker() == {"b": {"c0": 9}, "a": {"c1": 2}}


WORKERS = ("a", "b", "c")
Spread = dict[str | None, list[str]]


def after(jobs: Spread, moves: Mapping[str, str]) -> Spread:
    where = {job_id: worker for worker, own in jobs.items() for job_id in own}
    where |= moves
    return {worker: [j for j, at in where.items() if at == worker] for worker in {*jobs, *WORKERS}}


@st.composite
def spreads(draw: st.DrawFn) -> Spread:
    places = draw(st.lists(st.sampled_from([None, *WORKERS, "gone"]), max_size=15))
    jobs: Spread = {}
    for number, place in enumerate(places):
        jobs.setdefault(place, []).append(f"c{number}")
    return jobs


@given(spreads())
def test_no_worker_has_two_jobs_more_than_another_and_no_job_waits_or_moves_for_nothing(
    jobs: Spread,
) -> None:
    moves = balanced(jobs, WORKERS, lambda _: True)
    spread = after(jobs, moves)
    sizes = [len(spread[worker]) for worker in WORKERS]
    assert max(sizes) - min(sizes) < 2
    assert not spread.get(None)
    assert not balanced(spread, WORKERS, lambda _: True)
    assert not set(moves) & set(jobs.get("gone", [])), "a worker that may get none"
    assert set(balanced(jobs, WORKERS, lambda _: False)) == set(jobs.get(None, []))


def test_the_least_loaded_worker_gets_a_job_and_of_equals_the_first_by_name() -> None:
    moves = balanced({None: ["c3", "c2"], "a": ["c0"]}, ["b", "a"], lambda _: True)
    assert list(moves.items()) == [("c2", "b"), ("c3", "a")]
    assert not balanced({None: ["c0"]}, [], lambda _: True), "it waits for a worker"
