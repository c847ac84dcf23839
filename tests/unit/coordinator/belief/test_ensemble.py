import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.belief.ensemble import ELSEWHERE, Ensemble
from clustermcl.belief.outcome import BEFORE_FIRST_STEP, Outcome, belief_after
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.protocol.answers import Belief
from clustermcl.protocol.job_events import Began, Ended
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.why import Why
from clustermcl.protocol.work import ElsewhereJob, Report, SearchJob, TrackJob
from tests.unit.coordinator.reports import elsewhere, literal_bayes, place, scan, searched, tracked

NORTH, SOUTH, EAST = (0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (5.0, 0.0, 0.0)


def ensemble(**belief: object) -> Ensemble:
    rules = literal_bayes(**{"max_clusters": 3, **belief})
    return Ensemble.of(FilterSettings(search=SearchSettings(shards=2), belief=rules))


def bootstrapped(places: dict[PoseTuple, float], **belief: object) -> Ensemble:
    """An ensemble whose first search has ended at step 0 with these places."""
    made = ensemble(**belief)
    made.begin_at(0)
    made.advance(0, [searched(f"s0.{shard}", 0, places) for shard in range(2)])
    return made


def probabilities(outcome: Outcome) -> dict[int, float]:
    return {h.cluster: h.probability for h in outcome.hypotheses}


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


def test_a_place_that_becomes_probable_gets_particles_from_improbable_ones() -> None:
    made = ensemble(particles=4_000)
    rules = made.settings.cluster
    assert (rules.min_particles, rules.particles) == (500, 2_000)
    made.begin_at(0)
    reports = [searched(f"s0.{n}", 0, {NORTH: 0.7, SOUTH: 0.2, EAST: 0.1}) for n in range(2)]
    begun = made.advance(0, reports).begin.values()
    assert [job.particles for job in begun if isinstance(job, TrackJob)] == [2_000, 500, 500]
    sizes = {}
    for step in range(1, 41):
        log_likelihood = {"c0": -10.0, "c1": 0.0, "c2": -10.0} if step == 15 else {}
        outcome = made.advance(
            step,
            [
                tracked(f"c{n}", step, math.exp(log_likelihood.get(f"c{n}", 0.0)), mean)
                for n, mean in enumerate((NORTH, SOUTH, EAST))
            ],
        )
        if outcome.resize:
            sizes[step] = outcome.resize
    assert sizes == {20: {"c0": (500, 30), "c1": (2_000, 30)}}


def test_numbers_of_particles_do_not_change_while_a_probability_fluctuates() -> None:
    made = ensemble(particles=4_000)
    made.begin_at(0)
    reports = [searched(f"s0.{n}", 0, {NORTH: 0.74, SOUTH: 0.26}) for n in range(2)]
    begun = made.advance(0, reports).begin.values()
    assert [job.particles for job in begun if isinstance(job, TrackJob)] == [2_000, 1_000]
    for step in range(1, 81):
        likelier = 1.2 if step % 40 == 20 else 1.2 ** (-1.0) if step % 40 == 21 else 1.0
        reports = [tracked("c0", step, likelier, NORTH), tracked("c1", step, 1.0, SOUTH)]
        assert made.advance(step, reports).resize == {}


def test_a_search_goes_on_while_its_best_places_hold_too_little() -> None:
    made = ensemble()
    made.begin_at(0)
    scattered = {(float(i) * 3.0, 0.0, 0.0): 0.1 for i in range(10)}
    outcome = made.advance(0, [searched(f"s0.{n}", 0, scattered) for n in range(2)])
    assert outcome.searching
    assert probabilities(outcome) == pytest.approx({0: 1 / 3, 1: 1 / 3, 2: 1 / 3}), "so far"
    assert list(outcome.begin) == ["c0", "c1", "c2"]


def test_a_candidate_enters_with_a_small_probability_and_the_least_probable_leaves() -> None:
    places = {NORTH: 0.65, SOUTH: 0.325, EAST: 0.01}
    made = bootstrapped(places, search_every_steps=1, kidnapping_probability=1e-12)
    new: PoseTuple = (-5.0, 0.0, 0.0)
    tracks = {"c0": NORTH, "c1": SOUTH, "c2": EAST}
    started = made.advance(1, [tracked(job, 1, 0.1, mean) for job, mean in tracks.items()])
    assert set(started.begin) == {"s1.0", "s1.1"}
    reports: list[Report] = [tracked(job, 2, 0.1, mean) for job, mean in tracks.items()]
    reports += [searched(f"s1.{n}", 2, {new: 0.9, NORTH: 0.1}) for n in range(2)]
    outcome = made.advance(2, reports)
    share = 0.9 * 0.015 / (0.975 + 0.015)  # of what elsewhere has
    assert probabilities(outcome)[3] == pytest.approx(share)
    assert outcome.events == (
        Ended("c2", "pushed out", ("c3",), pytest.approx(0.01)),
        Began("c3", "restart", pytest.approx(share)),
        Ended("s1.0", "search over"),
        Ended("s1.1", "search over"),
    )
    assert probabilities(outcome)[0] / probabilities(outcome)[1] == pytest.approx(2.0)
    total = sum(probabilities(outcome).values()) + outcome.elsewhere_probability
    assert total == pytest.approx(1.0)


@pytest.mark.parametrize("reporting", [("c0",), ("c0", "c1")])
def test_a_search_is_compared_with_clusters_moved_by_odometry(reporting: tuple[str, ...]) -> None:
    """The robot drove on while workers were late: what the search finds looks new, and is not."""
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4}, search_every_steps=1)
    made.advance(1, [tracked("c0", 1, 0.1, NORTH), tracked("c1", 1, 0.1, SOUTH)])
    moved: dict[str, PoseTuple] = {"c0": (2.0, 5.0, 0.0), "c1": (2.0, -5.0, 0.0)}
    reports: list[Report] = [tracked(job, 2, 0.1, moved[job]) for job in reporting]
    found = {moved["c0"]: 0.6, moved["c1"]: 0.4}
    reports += [searched(f"s1.{n}", 2, found) for n in range(2)]
    outcome = made.advance(2, reports, np.array([2.0, 0.0, 0.0]))
    assert set(probabilities(outcome)) == {0, 1}
    assert not outcome.searching


def test_a_search_that_lags_behind_is_compared_with_where_the_clusters_were() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4}, search_every_steps=1)
    made.advance(1, [tracked("c0", 1, 0.1, NORTH), tracked("c1", 1, 0.1, SOUTH)])
    made.advance(2, [tracked("c0", 2, 0.1, NORTH), tracked("c1", 2, 0.1, SOUTH)])
    late: list[Report] = [searched(f"s1.{n}", 2, {NORTH: 0.6, SOUTH: 0.4}) for n in range(2)]
    moved = [tracked("c0", 3, 0.1, (0.0, 7.0, 0.0)), tracked("c1", 3, 0.1, (0.0, -3.0, 0.0))]
    outcome = made.advance(3, [*moved, *late])
    assert set(probabilities(outcome)) == {0, 1}
    assert not outcome.searching


@pytest.mark.parametrize("log_elsewhere", [math.log(0.05), math.log(5.0), None])
def test_the_first_scan_after_a_given_pose_decides(log_elsewhere: float | None) -> None:
    """Also if the robot stands, where scans are no news otherwise."""
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5}, kidnapping_probability=0.001)
    assert made.set_pose(place(0.95, EAST, 0)).state == "searching"
    assert made.advance(1, [], np.zeros(3)).state == "searching", "it is lost"
    reports: list[Report] = [tracked("c2", 2, 0.1, EAST)]
    if log_elsewhere is not None:
        reports.append(elsewhere(2, log_elsewhere))
    weighed = made.advance(2, reports, np.zeros(3))
    assert weighed.state == ("ambiguous" if log_elsewhere == math.log(5.0) else "localized")
    assert made.advance(3, [], np.zeros(3)).state == weighed.state


def test_a_command_stops_the_search_that_runs() -> None:
    made = ensemble()
    made.begin_at(0)
    stopped = [Ended(job_id, "search stopped") for job_id in ("s0.0", "s0.1")]
    assert made.relocalize(0).events == tuple(stopped)
    assert made.set_pose(place(0.95, EAST, 0)).events == (
        *(Ended(job_id, "search stopped") for job_id in ("s1.0", "s1.1")),
        Began("c0", "given", 1.0),
    )


def test_relocalize_near_a_place_or_on_a_floor_searches_there_and_later_everywhere() -> None:
    made, near, corners = bootstrapped({NORTH: 1.0}), (3.0, 4.0, 10.0), ((0.0, 0.0), (4.0, 5.0))
    searches = [made.relocalize(0, near=near), made.relocalize(1, corners=corners)]
    found = [
        [(job.near, job.corners) for job in outcome.begin.values() if isinstance(job, SearchJob)]
        for outcome in [*searches, made.relocalize(2)]
    ]
    assert found == [[(near, None)] * 2, [(None, corners)] * 2, [(None, None)] * 2]


@pytest.mark.parametrize("step", [1, 2])
def test_places_of_the_search_that_found_the_clusters_continue_to_enter(step: int) -> None:
    """The clusters that it shares give its weight, also if no cluster has weighed a scan."""
    made = ensemble(max_clusters=4)
    made.begin_at(0)
    first = {NORTH: 0.3, SOUTH: 0.1}
    outcome = made.advance(0, [searched(f"s0.{n}", 0, first) for n in range(2)])
    assert probabilities(outcome) == pytest.approx({0: 0.75, 1: 0.25})
    for before in range(1, step):
        made.advance(before, [])
    tracks: list[Report] = [tracked("c0", step, 0.1, NORTH), tracked("c1", step, 0.1, SOUTH)]
    later = {NORTH: 0.5, EAST: 0.2, (0.0, -5.4, 0.0): 0.1}
    outcome = made.advance(step, [*tracks, *(searched(f"s0.{n}", step, later) for n in range(2))])
    # The clusters have 1.0 where the search has 0.6.
    total = 1.0 + 0.2 / 0.6
    expected = {0: 0.75, 1: 0.25, 2: 0.2 / 0.6}
    assert probabilities(outcome) == pytest.approx({c: p / total for c, p in expected.items()})
    assert outcome.searching
    assert [event for event in outcome.events if isinstance(event, Ended)] == []


def test_a_search_report_of_a_step_before_its_start_is_ignored() -> None:
    made = ensemble()
    made.begin_at(7)
    outcome = made.advance(7, [searched(f"s0.{n}", 3, {NORTH: 1.0}) for n in range(2)])
    assert outcome.hypotheses == ()
    assert outcome.searching


@pytest.mark.parametrize(("fit", "times"), [(1.0, 1), (1e-9, 4)])
def test_a_search_is_short_while_the_robot_is_localized(fit: float, times: int) -> None:
    """It looks around; one that may have to find a robot that was lost has more patience."""
    made = bootstrapped({NORTH: 1.0}, search_every_steps=1, kidnapping_probability=0.001)
    first = [tracked("c0", 1, fit, NORTH), elsewhere(1, math.log(1e-3))]
    first_step = made.advance(1, first).step + 1
    scattered = {(3.0 * number, 9.0, 0.0): 0.1 for number in range(10)}
    most = times * made.settings.search.max_steps
    for steps in range(1, most + 1):
        step = first_step + steps - 1
        clusters = [tracked(c.job_id, step, fit, c.pose) for c in made.clusters.all()]
        nowhere = elsewhere(step, math.log(1e-3))
        found = [searched(f"s1.{shard}", step, scattered) for shard in range(2)]
        outcome = made.advance(step, [*clusters, nowhere, *found])
        ended = {event.cause for event in outcome.events if event.job_id == "s1.0"}
        assert ended == ({"search over"} if steps == most else set()), steps


def lifted(made: Ensemble, step: int, search: int, evidence: float = 99.0) -> Outcome:
    clusters = [tracked(c.job_id, step, 1e-9, c.pose) for c in made.clusters.all()]
    place = {EAST: 1.0}
    reports = [searched(f"s{search}.{n}", step, place, log_evidence=evidence) for n in range(2)]
    return made.advance(step, [*clusters, elsewhere(step, math.log(1e-3)), *reports])


def test_a_search_from_before_a_kidnapping_begins_again() -> None:
    """It would look for where the robot was."""
    made = bootstrapped({NORTH: 1.0}, search_every_steps=1, kidnapping_probability=0.001)
    started = made.advance(1, [tracked("c0", 1, 1.0, NORTH), elsewhere(1, math.log(1e-3))])
    assert "s1.0" in started.begin
    outcome = made.advance(2, [tracked("c0", 2, 1e-9, NORTH), elsewhere(2, math.log(1e-3))])
    assert Ended("s1.0", "search stopped") in outcome.events
    assert outcome.begin.get("s2.0") == SearchJob(search=2, shard=0, first_step=3)


def test_after_a_given_pose_elsewhere_is_weighed_from_the_next_step_on() -> None:
    made = bootstrapped({NORTH: 1.0}, kidnapping_probability=0.001)
    outcome = made.continue_from([place(1.0, SOUTH, 7)], 7, "new map")
    assert outcome.begin[ELSEWHERE] == ElsewhereJob(first_step=8)


def test_a_robot_that_is_lost_is_as_lost_on_a_new_map() -> None:
    made = bootstrapped({NORTH: 1.0}, kidnapping_probability=0.001, off_map_probability=0.05)
    outcome = made.continue_from([place(0.1, SOUTH, 7)], 7, "new map")
    assert outcome.elsewhere_probability == pytest.approx(0.9, abs=0.01)


def test_the_published_belief_has_all_that_the_outcome_says_of_a_scan() -> None:
    outcome = replace(
        BEFORE_FIRST_STEP, step=4, state="lost", elsewhere_probability=0.5, searching=True,
        missing=("c1",), off_map_probability=0.2, search_progress=0.3, why=Why({"scan": (1.0,)}),
    )  # fmt: skip
    of = scan(3, x_m=2.0, last=True)
    belief = belief_after(of, outcome, "me", 7)
    for same, names in ((outcome, Outcome.__struct_fields__), (of, ("stamp_ns", "last"))):
        shared = set(names) & set(Belief.__struct_fields__)
        assert {n: getattr(belief, n) for n in shared} == {n: getattr(same, n) for n in shared}
    assert (belief.sender, belief.term, belief.odom_from_robot) == ("me", 7, of.odom_from_robot)


def test_a_lost_robot_is_localized_as_soon_as_a_search_has_found_it() -> None:
    made = bootstrapped(
        {NORTH: 1.0}, kidnapping_probability=0.01, off_map_probability=0.05, search_every_steps=1
    )
    made.advance(1, [tracked("c0", 1, 1.0, NORTH), elsewhere(1, math.log(1e-3))])
    lost, found = (lifted(made, step, search=2) for step in (2, 3))
    assert (lost.state, found.state, found.hypotheses[0].pose) == ("lost", "localized", EAST)
