import numpy as np

from coordinator.membership.jobs import PlacedJob
from coordinator.membership.second_keepers import NEW_COPY_EVERY_STEPS, SecondKeepers
from protocol.arrays import ArrayBlob
from protocol.work import Assignment, Particles, TrackJob, steps_of

Kept = dict[str, dict[str, int]]


def tracked(worker: str, step: int = 0) -> PlacedJob:
    start = Particles(
        step=step,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(np.zeros((1, 3)), "float64"),
        log_weights=ArrayBlob.of(np.zeros(1), "float64"),
    )
    return PlacedJob(TrackJob(cluster=0, start=start, exact=True), epoch=1, worker=worker)


def kept(copies: dict[str, list[Assignment]]) -> Kept:
    return {worker: steps_of(given) for worker, given in copies.items()}


def test_a_cluster_s_copy_is_with_another_worker_than_its_own() -> None:
    copies = SecondKeepers().copies({"c0": tracked("a"), "c1": tracked("b")}, ["a", "b"])
    assert kept(copies) == {"b": {"c0": 0}, "a": {"c1": 0}}


def test_copies_are_spread_over_the_workers() -> None:
    jobs = {f"c{n}": tracked("a") for n in range(4)}
    copies = SecondKeepers().copies(jobs, ["a", "b", "c"])
    assert kept(copies) == {"b": {"c0": 0, "c2": 0}, "c": {"c1": 0, "c3": 0}}


def test_a_worker_that_is_alone_keeps_no_copies() -> None:
    keepers = SecondKeepers()
    assert keepers.copies({"c0": tracked("a")}, ["a"]) == {}
    assert keepers.keeper("c0") is None


def test_a_copy_is_made_anew_when_it_is_old_and_stays_where_it_is() -> None:
    keepers = SecondKeepers()
    keepers.copies({"c0": tracked("a", step=7)}, ["a", "b", "c"])
    young, old = 7 + NEW_COPY_EVERY_STEPS - 1, 7 + NEW_COPY_EVERY_STEPS
    for step, copied in ((young, 7), (old, old), (3, 3)):  # the last: steps are counted anew
        assert kept(keepers.copies({"c0": tracked("a", step)}, ["a", "b", "c"])) == {
            "b": {"c0": copied}
        }


def test_who_is_gone_or_has_got_the_cluster_itself_keeps_its_copy_no_longer() -> None:
    for worker, workers in (("a", ["a", "c"]), ("b", ["a", "b", "c"])):
        keepers = SecondKeepers()
        keepers.copies({"c0": tracked("a")}, ["a", "b"])
        copies = keepers.copies({"c0": tracked(worker, step=5)}, workers)
        assert worker not in copies
        assert [*kept(copies).values()] == [{"c0": 5}]


def test_of_a_cluster_that_is_over_there_is_no_copy() -> None:
    keepers = SecondKeepers()
    keepers.copies({"c0": tracked("a")}, ["a", "b"])
    assert keepers.copies({}, ["a", "b"]) == {}
