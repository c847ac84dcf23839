from collections.abc import Mapping

from hypothesis import given
from hypothesis import strategies as st

from clustermcl.coordinator.jobs import balanced

WORKERS = ("a", "b", "c")
Spread = dict[str | None, list[str]]


def always(_job_id: str) -> bool:
    return True


def never(_job_id: str) -> bool:
    return False


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
def test_no_worker_has_two_jobs_more_than_another_and_no_job_waits(jobs: Spread) -> None:
    spread = after(jobs, balanced(jobs, WORKERS, always))
    sizes = [len(spread[worker]) for worker in WORKERS]
    assert max(sizes) - min(sizes) < 2
    assert not spread.get(None)


@given(spreads())
def test_balanced_jobs_stay_where_they_are(jobs: Spread) -> None:
    assert not balanced(after(jobs, balanced(jobs, WORKERS, always)), WORKERS, always)


@given(spreads())
def test_only_waiting_jobs_get_a_worker_if_no_job_may_move(jobs: Spread) -> None:
    assert set(balanced(jobs, WORKERS, never)) == set(jobs.get(None, []))


@given(spreads())
def test_no_job_moves_from_a_worker_that_may_get_none(jobs: Spread) -> None:
    assert not set(balanced(jobs, WORKERS, always)) & set(jobs.get("gone", []))


def test_the_least_loaded_worker_gets_a_job_and_of_equals_the_first_by_name() -> None:
    moves = balanced({None: ["c3", "c2"], "a": ["c0"]}, ["b", "a"], always)
    assert list(moves.items()) == [("c2", "b"), ("c3", "a")]


def test_jobs_wait_without_a_worker() -> None:
    assert not balanced({None: ["c0"]}, [], always)
