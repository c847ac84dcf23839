import math

import pytest

from benchmarks.experiments.measures import (
    first_right,
    measures_of,
    update_of,
)
from clustermcl.protocol.answers import State
from tests.unit.benchmarks.experiments.made_up import (
    COPIES,
    NOWHERE,
    OPPOSITE,
    at,
    facts,
    right_or_wrong,
)
from tests.unit.evaluation.places import outcome


def test_a_step_records_the_probability_of_each_copy() -> None:
    step = facts(1, at(0.4), at(0.3, OPPOSITE), at(0.2, (5.5, 0.5, 0.1)), at(0.1, NOWHERE))
    assert step.copies == pytest.approx((0.6, 0.3))
    claims = [(place.probability, place.right) for place in step.facts.claims]
    assert claims == [(0.4, True), (0.3, False), (0.2, True), (0.1, False)]
    assert step.facts.right
    assert step.all_tracked
    assert step.leader == 0


def test_first_right_requires_five_right_estimates_in_a_row() -> None:
    assert first_right(right_or_wrong("rrrrwrrrrr")) == 6
    assert first_right(right_or_wrong("rrrrwrrrr")) is None
    assert first_right(right_or_wrong("ssrraar")) == 3


def test_shares_of_tracking_begin_after_the_first_search() -> None:
    run = right_or_wrong("sssaaarrww")
    made = measures_of(run)
    assert made.bootstrap_update == 4
    assert made.copies_found == 2
    assert made.all_tracked_share == pytest.approx(3 / 7)
    assert made.right_share == pytest.approx(0.5)
    assert made.entropy_min == 0.0
    assert made.localized_share == pytest.approx(0.4)
    assert made.localized_wrong_share == pytest.approx(0.2)


def test_tracking_is_measured_from_the_first_step_with_a_right_place() -> None:
    assert measures_of(right_or_wrong("swwwrrrrraw")).kept_share == pytest.approx(6 / 7)
    assert measures_of(right_or_wrong("swwwrrrr")).kept_share is None


def test_measures_after_a_kidnapping_are_counted_from_it() -> None:
    run = right_or_wrong("rrrrrr" + "WWWaa" + "wrrrrrr")
    made = measures_of(run, kidnapped_at_update=6, right_before_kidnap=False)
    assert made.alarm_after_kidnap == 4
    assert made.right_after_kidnap == 7
    never = measures_of(run[:11], kidnapped_at_update=6)
    assert never.right_after_kidnap is None


def test_shares_of_states_and_of_elsewhere_are_over_all_updates() -> None:
    states: list[State] = ["searching", "ambiguous", "lost", "localized", "localized"]
    run = [
        update_of(
            n,
            0,
            outcome(state, at(0.5), elsewhere=0.5, off_map=0.25 if n > 4 else 0.0),
            COPIES if n > 4 else (),
        )
        for n, state in enumerate(states, start=1)
    ]
    made = measures_of(run)
    assert (made.localized_share, made.ambiguous_share) == (0.4, 0.2)
    assert (made.lost_share, made.searching_share) == (0.2, 0.2)
    assert (made.elsewhere_probability, made.off_map_probability) == (0.5, 0.05)
    assert (made.log_score, made.brier) == (math.log(0.5), 0.25), "of the last one"
