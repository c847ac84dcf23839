"""Measures of made-up runs, small enough to check by hand."""

import pytest

from benchmarks.experiments.measures import Update, first_right, measures_of, update_of
from benchmarks.experiments.observability import turned_copies
from clustermcl.protocol.message import PoseTuple
from tests.unit.evaluation.places import outcome, place

TRUTH: PoseTuple = (5.0, 0.0, 0.0)
OPPOSITE: PoseTuple = (-5.0, 0.0, 3.14)
"""Its copy in a world that is symmetric about the origin."""
NOWHERE: PoseTuple = (50.0, 50.0, 0.0)
RUNS = {
    "r": ("localized", [place(1.0, TRUTH)]),
    "w": ("localized", [place(0.5, NOWHERE)]),
    "W": ("localized", [place(0.95, NOWHERE)]),
    "a": ("ambiguous", [place(0.6, TRUTH), place(0.4, OPPOSITE)]),
    "s": ("searching", [place(1.0, TRUTH)]),
    "l": ("lost", [place(0.3, OPPOSITE), place(0.2, (5.5, 0.5, 0.1)), place(0.1, TRUTH)]),
}


def run_of(letters: str) -> list[Update]:
    """Of steps that are right, wrong, wrong and sure, ambiguous, searching or lost."""
    copies = turned_copies(TRUTH, 2, (0.0, 0.0))
    return [
        update_of(n, n * 10**9, outcome(state, *places, elsewhere=0.5, off_map=0.25), copies)
        for n, (state, places) in enumerate((RUNS[letter] for letter in letters), start=1)
    ]


def test_a_step_records_the_probability_of_each_copy() -> None:
    (step,) = run_of("l")
    assert step.copies == pytest.approx((0.3, 0.3))
    assert [claim.error.right for claim in step.facts.claims] == [False, True, True]
    assert step.all_tracked
    assert step.leader == 0


@pytest.mark.parametrize(
    ("letters", "update"), [("rrrrwrrrrr", 6), ("rrrrwrrrr", None), ("ssrraar", 3)]
)
def test_first_right_requires_five_right_estimates_in_a_row(
    letters: str, update: int | None
) -> None:
    assert first_right(run_of(letters)) == update


def test_shares_of_tracking_begin_after_the_first_search_and_those_of_states_before() -> None:
    made = measures_of(run_of("sssaaarrww"))
    assert (made.bootstrap_update, made.copies_found) == (4, 2)
    assert made.all_tracked_share == pytest.approx(3 / 7)
    assert made.right_share == pytest.approx(0.5)
    assert made.entropy_min == 0.0
    assert (made.localized_share, made.ambiguous_share, made.searching_share) == (0.4, 0.3, 0.3)
    assert (made.elsewhere_probability, made.off_map_probability) == (0.5, 0.25)
    assert measures_of(run_of("swwwrrrrraw")).kept_share == pytest.approx(6 / 7)
    assert measures_of(run_of("swwwrrrr")).kept_share is None


def test_measures_after_a_kidnapping_are_counted_from_it() -> None:
    run = run_of("rrrrrr" + "WWWaa" + "wrrrrrr")
    made = measures_of(run, kidnapped_at_update=6, right_before_kidnap=False)
    assert (made.alarm_after_kidnap, made.right_after_kidnap) == (4, 7)
    assert measures_of(run[:11], kidnapped_at_update=6).right_after_kidnap is None
