import math

import msgspec
import numpy as np
import pytest

from coordinator.belief.cluster_set import ClusterSet, Newcomer
from coordinator.belief.ensemble import Ensemble
from coordinator.belief.outcome import Outcome
from particle_filter.settings import BeliefSettings, FilterSettings, SearchSettings
from protocol.job_events import Began, Ended
from protocol.message import PoseTuple
from protocol.work import Report, SearchJob, TrackJob
from tests.unit.coordinator.reports import place, searched, tracked

NORTH, SOUTH, EAST = (0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (5.0, 0.0, 0.0)


def ensemble(**belief: object) -> Ensemble:
    rules = {"clusters": 3, "transition_probability": 0.0, "evidence_bound": 100.0, **belief}
    return Ensemble(
        FilterSettings(
            search=SearchSettings(shards=2),
            belief=BeliefSettings(**rules),  # type: ignore[arg-type] # keywords of the test
        )
    )


def bootstrapped(places: dict[PoseTuple, float], **belief: object) -> Ensemble:
    """An ensemble whose first search has ended at step 0 with these places."""
    made = ensemble(**belief)
    made.begin_at(0)
    made.advance(0, [searched(f"s0.{shard}", 0, places) for shard in range(2)])
    return made


def probabilities(outcome: Outcome) -> dict[int, float]:
    return {h.cluster: h.probability for h in outcome.hypotheses}


def test_the_first_search_sees_the_first_scan_itself() -> None:
    jobs = ensemble().begin_at(7)
    assert jobs == {f"s0.{n}": SearchJob(search=0, shard=n, first_step=7) for n in range(2)}


def test_places_of_the_first_search_become_clusters_by_their_share_of_points() -> None:
    made = ensemble()
    made.begin_at(0)
    places = {NORTH: 0.6, SOUTH: 0.3, EAST: 0.1}
    outcome = made.advance(0, [searched(f"s0.{n}", 0, places) for n in range(2)])
    assert probabilities(outcome) == pytest.approx({0: 0.6, 1: 0.3, 2: 0.1})
    assert outcome.events == (
        Began("c0", "first search", pytest.approx(0.6)),
        Began("c1", "first search", pytest.approx(0.3)),
        Began("c2", "first search", pytest.approx(0.1)),
        Ended("s0.0", "search over"),
        Ended("s0.1", "search over"),
    )
    assert all(isinstance(job, TrackJob) for job in outcome.begin.values())
    assert list(outcome.begin) == ["c0", "c1", "c2"]


def test_shards_count_by_their_evidence() -> None:
    made = ensemble()
    made.begin_at(0)
    outcome = made.advance(
        0,
        [
            searched("s0.0", 0, {NORTH: 1.0}, log_evidence=math.log(3.0)),
            searched("s0.1", 0, {SOUTH: 1.0}, log_evidence=math.log(1.0)),
        ],
    )
    assert probabilities(outcome) == pytest.approx({0: 0.75, 1: 0.25})


def test_a_search_goes_on_while_its_best_places_hold_too_little() -> None:
    made = ensemble()
    made.begin_at(0)
    scattered = {(float(i) * 3.0, 0.0, 0.0): 0.1 for i in range(10)}
    outcome = made.advance(0, [searched(f"s0.{n}", 0, scattered) for n in range(2)])
    assert outcome.state == "searching"
    assert outcome.searching
    assert not outcome.begin
    assert len(outcome.hypotheses) == 10, "what it holds possible so far is told"


def test_probability_times_average_likelihood_normalised_is_the_new_probability() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5})
    outcome = made.advance(1, [tracked("c0", 1, 0.3, NORTH), tracked("c1", 1, 0.1, SOUTH)])
    assert probabilities(outcome) == pytest.approx({0: 0.75, 1: 0.25})


def test_a_missing_report_leaves_a_probability_where_it_was() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.3, EAST: 0.2})
    reports: list[Report] = [tracked("c0", 1, 0.1, NORTH), tracked("c2", 1, 0.5, EAST)]
    outcome = made.advance(1, reports)
    assert outcome.missing == ("c1",)
    assert probabilities(outcome)[1] == pytest.approx(0.3)
    assert probabilities(outcome)[0] == pytest.approx(0.7 * 0.05 / 0.15)


def test_clusters_that_come_together_merge_and_their_probabilities_add() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.3, EAST: 0.2}, merge_every_steps=1)
    outcome = made.advance(
        1,
        [
            tracked("c0", 1, 0.1, NORTH),
            tracked("c1", 1, 0.1, NORTH),
            tracked("c2", 1, 0.1, EAST),
        ],
    )
    assert probabilities(outcome) == pytest.approx({0: 0.8, 2: 0.2})
    assert outcome.events == (Ended("c1", "merged", ("c0",), pytest.approx(0.3)),)


def test_a_newcomer_enters_with_a_small_probability_and_the_least_probable_leaves() -> None:
    places = {NORTH: 0.64, SOUTH: 0.32, EAST: 0.04}
    made = bootstrapped(places, search_every_steps=1, newcomer_probability=0.02)
    new: PoseTuple = (-5.0, 0.0, 0.0)
    tracks = {"c0": NORTH, "c1": SOUTH, "c2": EAST}
    started = made.advance(1, [tracked(job, 1, 0.1, mean) for job, mean in tracks.items()])
    assert set(started.begin) == {"s1.0", "s1.1"}
    reports: list[Report] = [tracked(job, 2, 0.1, mean) for job, mean in tracks.items()]
    reports += [searched(f"s1.{n}", 2, {new: 0.9, NORTH: 0.1}) for n in range(2)]
    outcome = made.advance(2, reports)
    assert probabilities(outcome)[3] == pytest.approx(0.02)
    assert outcome.events == (
        Ended("c2", "pushed out", ("c3",), pytest.approx(0.04)),
        Began("c3", "restart", pytest.approx(0.02)),
        Ended("s1.0", "search over"),
        Ended("s1.1", "search over"),
    )
    assert probabilities(outcome)[0] / probabilities(outcome)[1] == pytest.approx(2.0)
    assert sum(probabilities(outcome).values()) == pytest.approx(1.0)


@pytest.mark.parametrize(("usual_fit", "probability"), [(-1.0, 0.3), (0.0, 0.1)])
def test_a_lost_robot_is_looked_for_most_where_scans_fit_as_usual(
    usual_fit: float, probability: float
) -> None:
    """The search's best place fits with -1: as usual, or much worse, as with people around."""
    made = bootstrapped({NORTH: 1.0})
    made.advance(1, [tracked("c0", 1, 0.1, NORTH, fit=usual_fit)])
    outcome = made.advance(2, [tracked("c0", 2, 0.1, NORTH, fit=-9.0)])
    assert outcome.state == "lost"
    reports: list[Report] = [tracked("c0", 3, 0.1, NORTH, fit=-9.0)]
    reports += [searched(f"s1.{n}", 3, {EAST: 1.0}) for n in range(2)]
    assert probabilities(made.advance(3, reports))[1] == pytest.approx(probability)


def test_a_place_that_a_cluster_holds_does_not_enter_again() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4}, search_every_steps=1)
    tracks = {"c0": NORTH, "c1": SOUTH}
    made.advance(1, [tracked(job, 1, 0.1, mean) for job, mean in tracks.items()])
    reports: list[Report] = [tracked(job, 2, 0.1, mean) for job, mean in tracks.items()]
    reports += [searched(f"s1.{n}", 2, {NORTH: 1.0}) for n in range(2)]
    outcome = made.advance(2, reports)
    assert not any(isinstance(job, TrackJob) for job in outcome.begin.values())
    assert set(probabilities(outcome)) == {0, 1}


def found_far_away(made: Ensemble, fit: float) -> Outcome:
    """Two steps, tracked with the same fit; in the second a search has found a place nobody has."""
    places = {"c0": NORTH, "c1": SOUTH, "c2": EAST}
    for step in (1, 2):
        reports: list[Report] = [
            msgspec.structs.replace(
                tracked(job, step, 0.1, mean), log_likelihood_per_beam=fit if step == 2 else -1.0
            )
            for job, mean in places.items()
        ]
        if step == 2:
            reports += [searched(f"s1.{n}", 2, {(-5.0, 0.0, 0.0): 1.0}) for n in range(2)]
        outcome = made.advance(step, reports)
    return outcome


def test_while_scans_fit_a_place_the_robot_may_well_be_at_makes_room_for_nobody() -> None:
    """Rooms exactly alike: each is true as far as anybody knows, and there are K of them."""
    alike = {NORTH: 0.6, SOUTH: 0.3, EAST: 0.1}
    made = bootstrapped(alike, search_every_steps=1)
    outcome = found_far_away(made, fit=-1.0)
    assert set(probabilities(outcome)) == {0, 1, 2}
    assert not [event for event in outcome.events if not event.is_search]
    improbable = {NORTH: 0.64, SOUTH: 0.32, EAST: 0.04}
    made = bootstrapped(improbable, search_every_steps=1)
    assert set(probabilities(found_far_away(made, fit=-1.0))) == {0, 1, 3}


def test_a_lost_robot_may_be_elsewhere_so_the_least_probable_makes_room() -> None:
    alike = {NORTH: 0.4, SOUTH: 0.35, EAST: 0.25}
    made = bootstrapped(alike, search_every_steps=1)
    outcome = found_far_away(made, fit=-9.0)
    assert outcome.state == "lost"
    assert set(probabilities(outcome)) == {0, 1, 3}


@pytest.mark.parametrize(("likelihood_of_east", "stays"), [(0.1, True), (1e-4, False)])
def test_for_a_place_beside_a_cluster_nobody_more_probable_leaves(
    likelihood_of_east: float, stays: bool
) -> None:
    """0.7 m from a cluster: not yet merged, but more likely that cluster's own than a new one."""
    made = bootstrapped({NORTH: 0.4, SOUTH: 0.3, EAST: 0.3}, search_every_steps=1)
    likelihoods = {"c0": 0.1, "c1": 0.1, "c2": likelihood_of_east}
    places = dict(zip(likelihoods, (NORTH, SOUTH, EAST), strict=True))
    tracks = [tracked(job, 1, likelihoods[job], mean) for job, mean in places.items()]
    made.advance(1, tracks)
    beside = (0.7, 5.0, 0.0)
    reports: list[Report] = [tracked(job, 2, 0.1, mean) for job, mean in places.items()]
    outcome = made.advance(2, [*reports, *(searched(f"s1.{n}", 2, {beside: 1.0}) for n in (0, 1))])
    assert set(probabilities(outcome)) == ({0, 1, 2} if stays else {0, 1, 3})


def test_a_place_beside_a_cluster_takes_a_free_place_after_those_far_from_all() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4}, search_every_steps=1)
    tracks = {"c0": NORTH, "c1": SOUTH}
    made.advance(1, [tracked(job, 1, 0.1, mean) for job, mean in tracks.items()])
    reports: list[Report] = [tracked(job, 2, 0.1, mean) for job, mean in tracks.items()]
    found = {(0.7, 5.0, 0.0): 0.7, EAST: 0.3}
    outcome = made.advance(2, [*reports, *(searched(f"s1.{n}", 2, found) for n in (0, 1))])
    assert [h.mean for h in outcome.hypotheses] == [NORTH, SOUTH, EAST], "there was one free place"
    assert probabilities(outcome)[2] == pytest.approx(0.02)


def test_while_a_cluster_is_not_heard_of_nobody_enters_in_its_place() -> None:
    """The workers died while the robot drove on: what the search finds looks new, and is not."""
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4}, search_every_steps=1, clusters=2)
    made.advance(1, [tracked("c0", 1, 0.1, NORTH), tracked("c1", 1, 0.1, SOUTH)])
    moved_north, moved_south = (0.0, 7.0, 0.0), (0.0, -3.0, 0.0)
    found = {moved_north: 0.6, moved_south: 0.4}
    reports: list[Report] = [searched(f"s1.{n}", 2, found) for n in range(2)]
    outcome = made.advance(2, [tracked("c0", 2, 0.1, moved_north), *reports])
    assert set(probabilities(outcome)) == {0, 1}
    assert outcome.searching, "it goes on until it can be told who is new"
    reports = [searched(f"s1.{n}", 3, found) for n in range(2)]
    tracks = [tracked("c0", 3, 0.1, moved_north), tracked("c1", 3, 0.1, moved_south)]
    outcome = made.advance(3, [*tracks, *reports])
    assert set(probabilities(outcome)) == {0, 1}
    assert not outcome.searching


def test_a_cluster_that_is_not_heard_of_moves_with_the_robot() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4})
    x_m, y_m, heading = NORTH
    assert heading == 0.0
    ahead = np.array([0.5, 0.0, 0.1])
    outcome = made.advance(1, [tracked("c1", 1, 0.1, SOUTH)], ahead)
    means = {h.cluster: h.mean for h in outcome.hypotheses}
    assert means[0] == pytest.approx((x_m + 0.5, y_m, 0.1))
    assert means[1] == SOUTH


def test_a_search_that_lags_behind_is_compared_with_where_the_clusters_were() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4}, search_every_steps=1)
    made.advance(1, [tracked("c0", 1, 0.1, NORTH), tracked("c1", 1, 0.1, SOUTH)])
    made.advance(2, [tracked("c0", 2, 0.1, NORTH), tracked("c1", 2, 0.1, SOUTH)])
    late: list[Report] = [searched(f"s1.{n}", 2, {NORTH: 0.6, SOUTH: 0.4}) for n in range(2)]
    moved = [tracked("c0", 3, 0.1, (0.0, 7.0, 0.0)), tracked("c1", 3, 0.1, (0.0, -3.0, 0.0))]
    outcome = made.advance(3, [*moved, *late])
    assert set(probabilities(outcome)) == {0, 1}
    assert not outcome.searching


def test_a_newcomer_in_its_grace_is_not_replaced() -> None:
    places = {NORTH: 0.98, SOUTH: 0.01, EAST: 0.01}
    made = bootstrapped(places, search_every_steps=1, grace_steps=50)
    tracks: dict[str, PoseTuple] = {"c0": NORTH, "c1": SOUTH, "c2": EAST}
    for step, x_m in ((1, 0.0), (2, -5.0), (3, 0.0), (4, -9.0), (5, 0.0), (6, -15.0)):
        reports: list[Report] = [tracked(job, step, 0.1, mean) for job, mean in tracks.items()]
        search = step // 2
        reports += [searched(f"s{search}.{n}", step, {(x_m, 0.0, 0.0): 1.0}) for n in range(2)]
        outcome = made.advance(step, reports)
        tracks = {f"c{h.cluster}": h.mean for h in outcome.hypotheses}
    assert set(tracks) == {"c0", "c3", "c4"}, "the first two stayed; a third found no room"


def test_a_pose_given_by_a_person_takes_its_probability_from_the_others() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5})
    outcome = made.set_pose(place(0.95, EAST, 0))
    assert probabilities(outcome) == pytest.approx({0: 0.025, 1: 0.025, 2: 0.95})
    assert outcome.state == "localized"
    assert outcome.events == (Began("c2", "given", pytest.approx(0.95)),)


def test_a_command_stops_the_search_that_runs() -> None:
    made = ensemble()
    made.begin_at(0)
    stopped = [Ended(job_id, "search stopped") for job_id in ("s0.0", "s0.1")]
    assert made.relocalize(0).events == tuple(stopped)
    assert made.set_pose(place(0.95, EAST, 0)).events == (
        *(Ended(job_id, "search stopped") for job_id in ("s1.0", "s1.1")),
        Began("c0", "given", 1.0),
    )


def test_who_is_pushed_out_is_told_by_whom() -> None:
    """Of three newcomers the first takes the free place, the others the least probable ones'."""
    clusters = ClusterSet(BeliefSettings(clusters=4))
    clusters.admit([(place(p, NORTH, 0), "first search") for p in (0.5, 0.2, 0.3)], 0)
    more: list[Newcomer] = [(place(0.1, EAST, 0), "restart") for _ in range(3)]
    _, events = clusters.admit(more, 1)
    assert [event for event in events if isinstance(event, Ended)] == [
        Ended("c1", "pushed out", ("c4",), pytest.approx(0.2)),
        Ended("c2", "pushed out", ("c5",), pytest.approx(0.3)),
    ]


def test_a_step_that_changes_no_cluster_has_no_events() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5})
    outcome = made.advance(1, [tracked("c0", 1, 0.1, NORTH), tracked("c1", 1, 0.1, SOUTH)])
    assert outcome.events == ()


def test_relocalize_forgets_everything_and_searches() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5})
    outcome = made.relocalize(0)
    assert outcome.hypotheses == ()
    assert outcome.state == "searching"
    assert outcome.events == tuple(Ended(job_id, "forgotten", (), 0.5) for job_id in ("c0", "c1"))
    assert all(isinstance(job, SearchJob) for job in outcome.begin.values())


def test_scans_that_fit_nowhere_any_more_make_the_state_lost_and_start_a_search() -> None:
    made = bootstrapped({NORTH: 1.0}, lost_fit_drop=0.5, search_every_steps=1000)
    for step in range(1, 20):
        outcome = made.advance(step, [tracked("c0", step, 0.1, NORTH, fit=0.5)])
    assert outcome.state == "localized"
    for step in range(20, 30):
        outcome = made.advance(step, [tracked("c0", step, 0.1, NORTH, fit=-1.5)])
    assert outcome.state == "lost"
    assert outcome.searching


def test_the_first_search_tells_no_more_against_a_place_than_its_steps_could() -> None:
    made = ensemble(evidence_bound=0.2)
    made.begin_at(0)
    for step in range(3):
        outcome = made.advance(
            step,
            [
                searched(
                    f"s0.{n}",
                    step,
                    {NORTH: 0.999, SOUTH: 0.001},
                    left_out_gap=12.0 if step == 2 else 0.0,
                )
                for n in range(2)
            ],
        )
    assert probabilities(outcome)[1] / probabilities(outcome)[0] == pytest.approx(math.exp(-0.6))


def test_one_step_tells_no_more_than_the_bound_against_a_cluster() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5}, evidence_bound=0.2)
    outcome = made.advance(1, [tracked("c0", 1, 0.3, NORTH), tracked("c1", 1, 1e-9, SOUTH)])
    assert probabilities(outcome)[1] / probabilities(outcome)[0] == pytest.approx(math.exp(-0.2))


def test_a_cluster_that_has_fallen_apart_becomes_two_that_share_its_probability() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4})
    parts = (place(0.75, (0.0, 5.0, 0.0), 1), place(0.25, (0.0, 8.0, 0.0), 1))
    apart = msgspec.structs.replace(tracked("c0", 1, 0.1, NORTH), parts=parts)
    outcome = made.advance(1, [apart, tracked("c1", 1, 0.1, SOUTH)])
    assert probabilities(outcome) == pytest.approx({1: 0.4, 2: 0.45, 3: 0.15})
    assert outcome.events == (
        Ended("c0", "split", ("c2", "c3"), pytest.approx(0.6)),
        Began("c2", "split", pytest.approx(0.45)),
        Began("c3", "split", pytest.approx(0.15)),
    )
    assert set(outcome.begin) == {"c2", "c3"}


def test_clusters_under_the_threshold_are_dropped_where_one_is_set() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.3, EAST: 0.1}, drop_below_probability=0.15)
    places: dict[str, PoseTuple] = {"c0": NORTH, "c1": SOUTH, "c2": EAST}
    outcome = made.advance(1, [tracked(job, 1, 0.1, mean) for job, mean in places.items()])
    assert probabilities(outcome) == pytest.approx({0: 2 / 3, 1: 1 / 3})
    assert outcome.events == (Ended("c2", "improbable", (), pytest.approx(0.1)),)


def test_a_place_whose_probability_underflows_is_tracked_with_next_to_none() -> None:
    clusters = ClusterSet(BeliefSettings(clusters=3))
    given: list[Newcomer] = [(place(p, NORTH, 0), "first search") for p in (1.0, 0.0)]
    admitted, _ = clusters.admit(given, 0)
    assert [cluster.cluster for cluster in admitted] == [0, 1]
    logs = [cluster.log_probability for cluster in clusters.by_probability()]
    assert logs[0] == pytest.approx(0.0)
    assert logs[1] == pytest.approx(-708.4, abs=0.1)


def test_a_search_cannot_tell_of_a_step_before_it_began() -> None:
    made = ensemble()
    made.begin_at(7)
    outcome = made.advance(7, [searched(f"s0.{n}", 3, {NORTH: 1.0}) for n in range(2)])
    assert outcome.hypotheses == ()
    assert outcome.searching
