import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.belief.bayes_update import PERHAPS_LIFTED
from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.outcome import Outcome
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.work import ElsewhereJob, Report
from tests.unit.coordinator.reports import (
    elsewhere,
    found_places,
    literal_bayes,
    place,
    resumed,
    searched,
    successor_of,
    tracked,
)

NORTH, SOUTH, EAST = (0.0, 5.0, 0.0), (0.0, -5.0, 0.0), (5.0, 0.0, 0.0)
HAZARD = 0.01


def ensemble(**belief: object) -> Ensemble:
    rules = {
        "kidnapping_probability": HAZARD,
        "max_clusters": 3,
        "lost_probability": 0.5,
        "localized_probability": 0.9,
        **belief,
    }
    return Ensemble.of(
        FilterSettings(search=SearchSettings(shards=1), belief=literal_bayes(**rules))
    )


def bootstrapped(places: dict[PoseTuple, float], **belief: object) -> Ensemble:
    """An ensemble whose first search has ended at step 0 with these places."""
    made = ensemble(**belief)
    made.begin_at(0)
    made.advance(0, [elsewhere(0, -3.0), searched("s0.0", 0, places)])
    return made


def believed(outcome: Outcome) -> dict[int, float]:
    assert math.fsum(
        [outcome.elsewhere_probability, *(h.probability for h in outcome.hypotheses)]
    ) == pytest.approx(1.0)
    return {h.cluster: h.probability for h in outcome.hypotheses}


def test_scans_are_weighed_elsewhere_from_the_first_one_on() -> None:
    made = ensemble()
    assert made.begin_at(7)["e0"] == ElsewhereJob(first_step=7)
    assert made.expected == ("s0.0", "e0")
    assert made.advance(7, []).missing == ("s0.0", "e0")
    never = ensemble(kidnapping_probability=0.0)
    assert set(never.begin_at(7)) == {"s0.0"}
    assert never.expected == ("s0.0",)


def test_probability_that_the_first_search_does_not_explain_is_elsewhere() -> None:
    made = ensemble()
    made.begin_at(0)
    nothing = made.advance(0, [elsewhere(0, -3.0)])
    assert (nothing.elsewhere_probability, nothing.state) == (1.0, "searching")
    found = {NORTH: 0.6, SOUTH: 0.2}
    outcome = made.advance(1, [elsewhere(1, -3.0), searched("s0.0", 1, found)])
    assert believed(outcome) == pytest.approx({0: 0.6, 1: 0.2})
    assert outcome.elsewhere_probability == pytest.approx(0.2)
    assert outcome.state == "ambiguous"


def at_north(step: int, log_fit: float, log_elsewhere: float) -> list[Report]:
    return [tracked("c0", step, math.exp(log_fit), NORTH), elsewhere(step, log_elsewhere)]


def test_after_a_kidnapping_it_is_lost_at_once_and_found_by_the_search_that_begins() -> None:
    made = bootstrapped({NORTH: 0.999}, search_every_steps=1000)
    for step in range(1, 6):
        outcome = made.advance(step, at_north(step, -1.0, -7.0))
        assert (outcome.state, outcome.searching) == ("localized", False)
    lifted = made.advance(6, at_north(6, -15.0, -6.0))
    assert lifted.state == "lost"
    assert lifted.elsewhere_probability > 0.95
    assert set(lifted.begin) == {"s1.0"}
    found = {SOUTH: 0.8, EAST: 0.2}
    # Over all the map, the search has found the scans as likely as e0 has.
    report = searched("s1.0", 8, found, log_evidence=-12.0)
    made.advance(7, at_north(7, -15.0, -6.0))
    outcome = made.advance(8, [*at_north(8, -15.0, -6.0), report])
    probabilities = believed(outcome)
    assert probabilities[0] < 0.001
    assert probabilities[1] == pytest.approx(0.8, abs=0.02)
    assert probabilities[2] == pytest.approx(0.2, abs=0.02)
    assert outcome.elsewhere_probability < 0.01
    assert outcome.state == "ambiguous"


def test_a_sudden_fall_of_the_fit_begins_a_search_whose_places_become_alternatives() -> None:
    """At a place that looks alike but for furniture a scan still fits far better than elsewhere."""
    made = bootstrapped({NORTH: 0.999}, search_every_steps=1000)
    for step in range(1, 30):
        assert made.advance(step, at_north(step, 3.0, -17.0)).state == "localized"
    lifted = made.advance(30, at_north(30, -5.0, -17.0))
    assert lifted.state == "ambiguous"
    assert set(lifted.begin) == {"s1.0"}
    found = searched("s1.0", 31, {NORTH: 0.01, SOUTH: 0.99}, log_evidence=-12.0)
    outcome = made.advance(31, [*at_north(31, -5.0, -17.0), found])
    assert outcome.state == "ambiguous"
    assert believed(outcome)[1] == pytest.approx(PERHAPS_LIFTED / (1.0 + PERHAPS_LIFTED), abs=0.05)


def test_a_fall_of_the_fit_that_a_search_cannot_explain_becomes_the_usual_fit() -> None:
    made = bootstrapped({NORTH: 0.999}, search_every_steps=1000)
    for step in range(1, 30):
        made.advance(step, at_north(step, 3.0, -17.0))
    assert made.advance(30, at_north(30, -5.0, -17.0)).searching
    found = searched("s1.0", 31, {NORTH: 0.99, SOUTH: 0.01}, log_evidence=-12.0)
    made.advance(31, [*at_north(31, -5.0, -17.0), found])
    for step in range(32, 40):
        outcome = made.advance(step, at_north(step, -5.0, -17.0))
        assert (outcome.state, outcome.searching) == ("localized", False)


def test_after_a_false_alarm_a_search_leaves_the_belief_where_it_was() -> None:
    """The scans fit again before the search ends, and it finds where the cluster is."""
    made = bootstrapped({NORTH: 0.999}, search_every_steps=1000)
    assert made.advance(1, at_north(1, -15.0, -6.0)).state == "lost"
    for step in range(2, 4):
        outcome = made.advance(step, at_north(step, -1.0, -7.0))
    assert outcome.state == "localized"
    found = searched("s1.0", 4, {NORTH: 0.9, SOUTH: 0.1}, log_evidence=-15.0)
    outcome = made.advance(4, [*at_north(4, -1.0, -7.0), found])
    assert believed(outcome)[0] > 0.98
    assert not outcome.searching


def test_a_search_is_worth_what_elsewhere_is_now() -> None:
    """Its scans have moved elsewhere already, so they do not count again."""
    made = bootstrapped({NORTH: 0.98}, search_every_steps=1, kidnapping_probability=1e-12)
    started = made.advance(1, at_north(1, -2.0, -2.0))
    assert set(started.begin) == {"s1.0"}
    assert started.elsewhere_probability == pytest.approx(0.02)
    made.advance(2, at_north(2, -3.0, -4.0))
    found = searched("s1.0", 3, {SOUTH: 0.25, NORTH: 0.75}, log_evidence=-6.0)
    outcome = made.advance(3, [*at_north(3, -5.0, -5.0), found])
    # Both hypotheses weighed both scans.
    north, there = 0.98 * math.exp(-8.0), 0.02 * math.exp(-9.0)
    total = north + there  # of which elsewhere keeps what the search gave to NORTH
    assert believed(outcome) == pytest.approx({0: north / total, 1: 0.25 * there / total})


def test_relocalize_moves_all_probability_elsewhere_and_restarts_its_evidence() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.39})
    outcome = made.relocalize(4)
    assert believed(outcome) == {}
    assert (outcome.elsewhere_probability, outcome.state) == (1.0, "searching")
    assert outcome.begin["e0"] == ElsewhereJob(first_step=5)
    assert set(outcome.begin) == {"e0", "s1.0"}
    assert set(outcome.end) == {"c0", "c1"}, "the old e0 goes by its epoch"


@pytest.mark.parametrize("rest", [0.2, 1e-6])
def test_a_place_that_an_observation_allows_takes_the_probability_of_elsewhere(rest: float) -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.4 - rest}, kidnapping_probability=1e-6)
    reports = [tracked(f"c{n}", 1, 1.0, mean) for n, mean in enumerate((NORTH, SOUTH))]
    allowed = replace(elsewhere(1, 0.0), places=found_places([(1.0, EAST)]))
    outcome = made.advance(1, [*reports, allowed])
    assert believed(outcome)[2] == pytest.approx(rest + (1.0 - rest) * 1e-6)
    assert outcome.elsewhere_probability == pytest.approx(0.0)


def test_a_given_pose_replaces_the_belief() -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.2})
    outcome = made.set_pose(place(0.95, EAST, 0))
    assert believed(outcome) == pytest.approx({2: 0.95})
    assert outcome.elsewhere_probability == pytest.approx(0.05)
    assert set(outcome.begin) == {"c2", "e0"}


@pytest.mark.parametrize(("spread_m", "state"), [(0.1, "localized"), (1.5, "ambiguous")])
def test_a_robot_in_a_wide_cloud_may_be_beyond_the_reach_of_its_place(
    spread_m: float, state: str
) -> None:
    made = bootstrapped({NORTH: 0.97})
    wide = (spread_m**2, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01)
    report = replace(tracked("c0", 1, 1.0, NORTH), covariance=wide)
    outcome = made.advance(1, [report, elsewhere(1, -3.0)])
    assert outcome.state == state
    share = math.erf(1.0 / (math.sqrt(2.0) * spread_m))
    assert believed(outcome)[0] == pytest.approx(share * made.clusters.clusters[0].probability)
    assert made.clusters.clusters[0].probability > 0.95, "what is tracked is as probable as before"
    assert outcome.why.of(0).get("width of the cloud", 0.0) == pytest.approx(
        log_odds_of(believed(outcome)[0]) - log_odds_of(made.clusters.clusters[0].probability),
        abs=2e-3,
    )


def log_odds_of(probability: float) -> float:
    return math.log(probability / (1.0 - probability))


@pytest.mark.parametrize(
    ("log_fits", "log_elsewhere", "fails"),
    [
        ([-2.0] * 30, -6.0, False),
        ([-15.0] * 30, -6.0, True),
        ([3.0] * 15 + [-20.0] * 15, -40.0, True),  # it was lifted to a place that looks alike
        ([3.0] * 10 + [3.0 - step for step in range(20)], -40.0, False),  # the building changed
    ],
)
def test_no_search_runs_beside_a_given_pose_until_it_fails(
    log_fits: list[float], log_elsewhere: float, fails: bool
) -> None:
    made = bootstrapped({NORTH: 0.6, SOUTH: 0.2}, search_every_steps=5)
    made.set_pose(place(0.95, EAST, 0))
    made = resumed(made)
    for step, log_fit in enumerate(log_fits, 1):
        reports = [tracked("c2", step, math.exp(log_fit), EAST), elsewhere(step, log_elsewhere)]
        outcome = made.advance(step, reports)
    assert outcome.searching == fails
    assert (outcome.state == "localized") == (log_elsewhere == -40.0 or not fails)


def test_a_robot_whose_first_place_was_given_is_lost_when_it_fails() -> None:
    made = ensemble()
    made.set_pose(place(0.95, EAST, 0))
    for step, log_fit in enumerate([-2.0] * 5 + [-15.0] * 25, 1):
        reports = [tracked("c0", step, math.exp(log_fit), EAST), elsewhere(step, -6.0)]
        outcome = made.advance(step, reports)
    assert (outcome.state, outcome.searching) == ("lost", True)


ENDS = [(1.0 + i, 9.0) for i in range(20)]
THROUGH = tracked("c1", 1, 1.0, EAST, fits=[-1.0] * len(ENDS))


def doubted() -> tuple[Ensemble, int]:
    """An ensemble whose beams are through walls at a given pose, at its first step of doubt."""
    made = bootstrapped(
        {NORTH: 1.0}, off_map_probability=0.05, least_probability=1e-4, piece_evidence=0.7
    )
    made.set_pose(place(0.95, EAST, 0))
    step = 0
    while made.clusters.given is not None:
        step += 1
        assert step < 20
        outcome = made.advance(
            step, [replace(THROUGH, step=step), elsewhere(step, -2.0, ends=ENDS)]
        )
    assert outcome.hypotheses[0].probability > 0.9
    assert outcome.searching
    return made, step


def after_search(made: Ensemble, step: int, fits: float, steps: int) -> Outcome:
    """The outcome some steps later, if the search finds a place where beams fit so well."""
    found = searched("s1.0", step + 1, {SOUTH: 1.0}, log_evidence=5.0 * fits)
    for later in range(step + 1, step + 1 + steps):
        seen = [(x, 9.0 * later) for x, _ in ENDS]
        reports = [replace(THROUGH, step=later), elsewhere(later, -2.0, ends=seen), found]
        reports.append(tracked("c2", later, 1.0, SOUTH, fits=[fits] * len(ENDS)))
        outcome = made.advance(later, reports)
    return outcome


@pytest.mark.parametrize("better", [False, True])
def test_beams_through_walls_make_a_given_pose_doubtful_until_a_search_has_ended(
    better: bool,
) -> None:
    """The state stays `localized` until then: a changed building looks the same."""
    outcome = after_search(*doubted(), fits=1.0 if better else -1.0, steps=5)
    assert outcome.hypotheses[0].pose == (SOUTH if better else EAST)
    assert (outcome.state, outcome.off_map_probability) == ("localized", 0.0)


def test_a_doubted_pose_stands_alone_again_once_it_has_held_against_what_a_search_found() -> None:
    """In a changed building one of many look-alikes would fit better by chance, sooner or later."""
    made, step = doubted()
    assert len(after_search(made, step, fits=-1.0, steps=14).hypotheses) == 2
    made = resumed(made)
    again = after_search(made, step + 14, fits=-1.0, steps=2)
    assert [place.pose for place in again.hypotheses] == [EAST]
    assert (again.state, again.searching) == ("localized", False)


def test_a_successor_receives_the_evidence_of_elsewhere() -> None:
    made = bootstrapped({NORTH: 0.95}, search_every_steps=1)
    made.advance(1, at_north(1, -2.0, -2.0))
    made.advance(2, at_north(2, -3.0, -4.0))
    again = resumed(made)
    assert successor_of(again) == successor_of(made)
    found = searched("s1.0", 3, {SOUTH: 0.25, NORTH: 0.75}, log_evidence=-6.0)
    reports = [*at_north(3, -5.0, -5.0), found]
    assert again.advance(3, reports) == made.advance(3, reports)


def test_a_robot_among_more_look_alikes_than_clusters_is_never_lost() -> None:
    """It stands: its first search ends with most of it elsewhere, and the next one begins."""
    rules = literal_bayes(kidnapping_probability=HAZARD, max_clusters=2)
    search = SearchSettings(shards=1, max_steps=1)
    made = Ensemble.of(FilterSettings(search=search, belief=rules))
    made.begin_at(0)
    states, jobs = set[str](), set[str]()
    for step in range(12):
        searches = [job for job in made.expected if job.startswith("s")]
        found = {NORTH: 0.02, SOUTH: 0.02}
        reports: list[Report] = [searched(job, step, found) for job in searches]
        places = zip(made.clusters.job_ids, found, strict=False)
        reports += [tracked(job, step, 1.0, mean) for job, mean in places]
        outcome = made.advance(step, [*reports, elsewhere(step, 0.0)], np.zeros(3))
        states.add(outcome.state)
        jobs |= set(searches)
    assert len(jobs) > 1
    assert states == {"searching"}


def test_the_first_search_has_lost_nothing_also_if_the_robot_may_be_off_the_map() -> None:
    made = ensemble()
    made.begin_at(0)
    found = searched("s0.0", 0, {NORTH: 0.3}, left_out_gap=0.0)
    assert made.advance(0, [elsewhere(0, -3.0), found]).state == "searching"
    made.clusters.log_elsewhere, made.clusters.log_off_map = math.log(0.1), math.log(0.7)
    assert made.outcome(0).state == "searching"
    over = searched("s0.0", 1, {NORTH: 1.0})
    ended = made.advance(1, [*at_north(1, -3.0, -3.0), over])
    assert (ended.state, ended.searching) == ("lost", False)


def test_a_robot_with_a_wrong_given_pose_is_searched_for_and_not_lost() -> None:
    """A standing robot gets steps while it is searched for."""
    made = bootstrapped({NORTH: 1.0}, off_map_probability=0.05)
    made.set_pose(place(0.95, EAST, 0))
    outcome = made.advance(1, [tracked("c1", 1, 1e-30, EAST), elsewhere(1, -2.0)])
    assert outcome.elsewhere_probability > 0.9
    assert (outcome.state, outcome.searching) == ("searching", True)
