import math

import pytest

from evaluation.experiments.measures import (
    brier,
    entropy_of_copies,
    first_alarm,
    first_right,
    leader_changes,
    log_score,
    measures_of,
    right_at,
)
from evaluation.experiments.step_facts import facts_of
from protocol.answers import State
from tests.unit.evaluation.experiments.made_up import (
    COPIES,
    NOWHERE,
    OPPOSITE,
    TRUTH,
    facts,
    place,
    right_or_wrong,
)


def test_a_step_notes_which_copy_has_which_probability() -> None:
    step = facts(
        1, place(0.4), place(0.3, OPPOSITE), place(0.2, (5.5, 0.5, 0.1)), place(0.1, NOWHERE)
    )
    assert step.copies == pytest.approx((0.6, 0.3))
    assert step.claims == ((0.4, True), (0.3, False), (0.2, True), (0.1, False))
    assert step.right
    assert step.all_tracked
    assert step.leader == 0


def test_right_ends_at_a_metre_and_at_20_degrees() -> None:
    x, y, heading = TRUTH
    for off, right in (((0.99, 0.0), True), ((1.01, 0.0), False)):
        assert facts(1, place(1.0, (x + off[0], y, heading))).right == right
    for degrees, right in ((19.9, True), (20.1, False)):
        turned = (x, y, heading + math.radians(degrees))
        assert facts(1, place(1.0, turned)).right == right


def test_while_searching_nothing_is_claimed() -> None:
    step = facts(1, place(1.0), state="searching")
    assert not step.right
    assert not step.confidently_wrong
    assert step.claims == ()
    assert step.leader is None


def test_confidently_wrong_is_wrong_with_nine_tenths_or_more() -> None:
    assert facts(1, place(0.9, NOWHERE)).confidently_wrong
    assert not facts(1, place(0.89, NOWHERE)).confidently_wrong
    assert not facts(1, place(1.0)).confidently_wrong


def test_the_first_right_ones_need_five_in_a_row() -> None:
    assert first_right(right_or_wrong("rrrrwrrrrr")) == 6
    assert first_right(right_or_wrong("rrrrwrrrr")) is None
    assert first_right(right_or_wrong("ssrraar")) == 3


def test_right_at_an_update_is_unknown_beyond_the_run() -> None:
    run = right_or_wrong("wr")
    assert (right_at(run, 1), right_at(run, 2), right_at(run, 3)) == (False, True, None)


def test_an_alarm_is_any_state_but_localized() -> None:
    assert first_alarm(right_or_wrong("rrWar")) == 4
    assert first_alarm(right_or_wrong("rrr")) is None


def test_the_entropy_of_two_copies() -> None:
    assert entropy_of_copies(facts(1, place(0.5), place(0.5, OPPOSITE))) == pytest.approx(1.0)
    uneven = facts(1, place(0.6), place(0.2, OPPOSITE), place(0.2, NOWHERE))
    three_to_one = -(0.75 * math.log2(0.75) + 0.25 * math.log2(0.25))
    assert entropy_of_copies(uneven) == pytest.approx(three_to_one)
    assert entropy_of_copies(facts(1, place(1.0))) == 0.0
    assert entropy_of_copies(facts(1, place(1.0, NOWHERE))) == 0.0


def test_changes_of_the_leader_pass_over_updates_without_one() -> None:
    ours, theirs = (place(0.6), place(0.4, OPPOSITE)), (place(0.4), place(0.6, OPPOSITE))
    lost = (place(1.0, NOWHERE),)
    run = [facts(n, *places) for n, places in enumerate((ours, lost, ours, theirs, lost, ours))]
    assert leader_changes(run) == 2


def test_shares_count_from_the_end_of_the_first_search() -> None:
    run = right_or_wrong("sssaaarrww")
    made = measures_of(run)
    assert made.bootstrap_update == 4
    assert made.copies_found == 2
    assert made.all_tracked_share == pytest.approx(3 / 7)
    assert made.right_share == pytest.approx(0.5)
    assert made.entropy_min == 0.0
    assert made.localized_share == pytest.approx(0.4)
    assert made.localized_wrong_share == pytest.approx(0.2)


def test_tracking_is_judged_from_when_it_first_held() -> None:
    assert measures_of(right_or_wrong("swwwrrrrraw")).kept_share == pytest.approx(6 / 7)
    assert measures_of(right_or_wrong("swwwrrrr")).kept_share is None


def test_what_happens_after_a_kidnapping_is_counted_from_it() -> None:
    run = right_or_wrong("rrrrrr" + "WWWaa" + "wrrrrrr")
    made = measures_of(run, kidnapped_at_update=6, right_before_kidnap=False)
    assert made.alarm_after_kidnap == 4
    assert made.right_after_kidnap == 7
    never = measures_of(run[:11], kidnapped_at_update=6)
    assert never.right_after_kidnap is None


def test_before_the_feature_is_seen_is_a_share_of_its_own() -> None:
    run = right_or_wrong("saaaarrr")
    made = measures_of(run, seen_at_update=6)
    assert made.all_tracked_until_seen_share == 1.0
    assert made.all_tracked_share == pytest.approx(4 / 7)
    assert measures_of(run).all_tracked_until_seen_share is None


def test_the_log_score_adds_right_places_up_and_is_bounded() -> None:
    split = facts(1, place(0.4, NOWHERE), place(0.35), place(0.15, (5.5, 0.5, 0.1)))
    assert log_score(split) == pytest.approx(math.log(0.5))
    assert log_score(facts(1, place(0.9995, NOWHERE), place(0.0005))) == math.log(0.001)
    assert log_score(facts(1)) == math.log(0.001)


def test_the_brier_score_is_0_for_the_truth_1_for_nothing_2_for_a_sure_error() -> None:
    assert brier(facts(1, place(1.0))) == 0.0
    assert brier(facts(1)) == 1.0
    assert brier(facts(1, place(1.0, NOWHERE))) == 2.0
    halves = facts(1, place(0.5), place(0.3, OPPOSITE), place(0.2, NOWHERE))
    assert brier(halves) == pytest.approx(0.25 + 0.09 + 0.04)


def test_places_of_a_first_search_are_scored_but_are_no_estimate() -> None:
    searching = facts(1, place(0.95), state="searching")
    assert (searching.claims, searching.right, searching.tracked) == ((), False, False)
    made = measures_of([searching, facts(2, place(0.5), place(0.5, OPPOSITE))])
    assert made.log_score == pytest.approx((math.log(0.95) + math.log(0.5)) / 2)
    assert made.brier == pytest.approx((0.05**2 + 0.5) / 2)
    assert made.sure_and_right_at_update is made.truth_lowest_once_sure is None


def test_sure_and_right_is_the_first_estimate_with_nine_tenths() -> None:
    run = [
        facts(1, place(0.95, NOWHERE), place(0.05)),
        facts(2, place(0.5), place(0.45, (5.5, 0.5, 0.1)), place(0.05, NOWHERE)),
        facts(3, place(0.9), place(0.1, NOWHERE)),
        facts(4, place(0.7, NOWHERE), place(0.3)),
        facts(5, place(1.0)),
    ]
    made = measures_of(run)
    assert made.sure_and_right_at_update == 3  # what the places of update 2 add up to is no one's
    assert made.truth_lowest_once_sure == 0.3
    assert measures_of(run[:2]).sure_and_right_at_update is None


def test_updates_without_ground_truth_are_in_no_score() -> None:
    unknown = facts_of(1, 0, "localized", [place(1.0, NOWHERE)], (), 0.7)
    told = facts_of(2, 0, "localized", [place(0.8)], COPIES, 0.2)
    made = measures_of([unknown, told])
    assert made.log_score == pytest.approx(math.log(0.8))
    assert made.brier == pytest.approx(0.04)
    assert measures_of([unknown]).brier is measures_of([]).log_score is None
    assert measures_of([facts(1, place(1.0))]).elsewhere_probability is None


def test_states_and_what_is_at_no_place_are_those_of_all_updates() -> None:
    states: list[State] = ["searching", "ambiguous", "lost", "localized", "localized"]
    run = [
        facts_of(n, 0, state, [place(0.5)], COPIES if n > 3 else (), 0.5, 0.25 if n > 3 else 0.0)
        for n, state in enumerate(states)
    ]
    made = measures_of(run)
    assert (made.localized_share, made.ambiguous_share) == (0.4, 0.2)
    assert (made.lost_share, made.searching_share) == (0.2, 0.2)
    assert (made.elsewhere_probability, made.off_map_probability) == (0.5, 0.05)


def test_an_empty_run_has_no_measures() -> None:
    made = measures_of([])
    assert made.bootstrap_update is made.entropy_mean is made.all_tracked_share is None
    assert made.right_within is made.right_at_50 is None


def test_the_made_up_copies_are_opposite() -> None:
    assert COPIES[1] == pytest.approx((-5.0, 0.0, -math.pi))
