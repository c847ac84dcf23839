from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st

from coordinator.jobs import Move, balanced

WORKERS = ("a", "b", "c")
Spread = dict[str | None, list[str]]


def always(_job_id: str) -> bool:
    return True


def never(_job_id: str) -> bool:
    return False


def after(jobs: Spread, moves: Sequence[Move]) -> Spread:
    """Each worker's jobs after the moves, one after the other."""
    where = {job_id: worker for worker, own in jobs.items() for job_id in own}
    where |= {move.job_id: move.worker for move in moves}
    return {worker: [j for j, at in where.items() if at == worker] for worker in {*jobs, *WORKERS}}


@st.composite
def spreads(draw: st.DrawFn) -> Spread:
    places = draw(st.lists(st.sampled_from([None, *WORKERS, "gone"]), max_size=15))
    jobs: Spread = {}
    for number, place in enumerate(places):
        jobs.setdefault(place, []).append(f"c{number}")
    return jobs


@given(spreads())
def test_afterwards_no_worker_has_two_more_than_another_and_nothing_waits(jobs: Spread) -> None:
    spread = after(jobs, balanced(jobs, WORKERS, always))
    sizes = [len(spread[worker]) for worker in WORKERS]
    assert max(sizes) - min(sizes) < 2
    assert not spread.get(None)


@given(spreads())
def test_what_is_balanced_stays_as_it_is(jobs: Spread) -> None:
    assert balanced(after(jobs, balanced(jobs, WORKERS, always)), WORKERS, always) == []


@given(spreads())
def test_only_jobs_that_wait_are_given_away_where_none_may_move(jobs: Spread) -> None:
    moved = {move.job_id for move in balanced(jobs, WORKERS, never)}
    assert moved == set(jobs.get(None, []))


@given(spreads())
def test_a_job_moves_once_at_most_and_never_from_one_who_may_have_none(jobs: Spread) -> None:
    moved = [move.job_id for move in balanced(jobs, WORKERS, always)]
    assert len(set(moved)) == len(moved)
    assert not set(moved) & set(jobs.get("gone", []))


def test_the_least_loaded_gets_a_job_and_of_equals_the_first_by_name() -> None:
    moves = balanced({None: ["c3", "c2"], "a": ["c0"]}, ["b", "a"], always)
    assert moves == [Move("c2", "b"), Move("c3", "a")]


def test_without_a_worker_jobs_wait() -> None:
    assert balanced({None: ["c0"]}, [], always) == []
