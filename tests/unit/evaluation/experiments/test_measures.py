import math

import pytest

from evaluation.experiments.measures import (
    entropy_of_copies,
    first_alarm,
    first_right,
    leader_changes,
    measures_of,
    right_at,
)
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


def test_a_run_of_nothing_has_no_numbers() -> None:
    made = measures_of([])
    assert made.bootstrap_update is made.entropy_mean is made.all_tracked_share is None
    assert made.right_within is made.right_at_50 is None


def test_the_made_up_copies_are_opposite() -> None:
    assert COPIES[1] == pytest.approx((-5.0, 0.0, -math.pi))
