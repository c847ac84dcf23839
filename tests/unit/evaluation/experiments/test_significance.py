"""Against values worked out by hand, or by R."""

import pytest

from evaluation.experiments.figures import mean, quantiles, rate
from evaluation.experiments.measures import RunMeasures
from evaluation.experiments.significance import p_value
from tests.unit.evaluation.experiments.made_up import measures

RIGHT = rate("right at the end", "localized", at_least=1)
ERROR = mean("error", "rmse_m")
SETTLED, _ = quantiles("right for good", "settled_at_update")


def right(pattern: str, first_seed: int = 0) -> dict[int, RunMeasures | None]:
    """`r` right, `w` wrong, `f` failed."""
    made = {"r": measures(localized=True), "w": measures(localized=False), "f": None}
    return {seed: made[letter] for seed, letter in enumerate(pattern, start=first_seed)}


def test_of_equal_seeds_only_the_pairs_that_differ_count() -> None:
    # 5 of 5 differing pairs one way: 2 / 2^5, however many pairs agree
    assert p_value(RIGHT, right("rrrrr"), right("wwwwf")) == pytest.approx(2 / 32)
    assert p_value(RIGHT, right("rrrrrrrr"), right("wwwwwrrr")) == pytest.approx(2 / 32)
    # 1 of 5 one way: 2 (1 + 5) / 2^5
    assert p_value(RIGHT, right("rrrrw"), right("wwwwr")) == pytest.approx(12 / 32)
    assert p_value(RIGHT, right("rwrw"), right("rwrw")) == 1.0


def test_of_other_seeds_there_are_no_pairs() -> None:
    # Fisher, 4 of 4 against 0 of 4: 2 / (8 over 4)
    assert p_value(RIGHT, right("rrrr"), right("wwww", first_seed=1)) == pytest.approx(2 / 70)
    assert p_value(RIGHT, right("rrr"), right("www")) == pytest.approx(2 / 8)


def errors(*values: float | None) -> dict[int, RunMeasures | None]:
    return {seed: measures(rmse_m=value) for seed, value in enumerate(values)}


def settled(*values: int | None) -> dict[int, RunMeasures | None]:
    return {seed: measures(settled_at_update=value) for seed, value in enumerate(values)}


def test_means_are_compared_pair_by_pair_where_both_have_the_measure() -> None:
    ours, theirs = errors(0.1, 0.2, 0.3, 0.4, 0.5, None), errors(0.2, 0.4, 0.6, 0.8, 1.0, 0.1)
    assert p_value(ERROR, ours, theirs) == pytest.approx(2 / 32)  # all five smaller
    assert p_value(ERROR, ours, ours) == 1.0
    assert p_value(ERROR, errors(None), errors(0.1)) is None


def test_who_never_gets_there_is_later_than_all() -> None:
    ours, theirs = settled(1, 2, 3, 4, 5), settled(None, 12, 23, 34, None)
    assert p_value(SETTLED, ours, theirs) == pytest.approx(2 / 32)
    assert p_value(SETTLED, settled(None, None), settled(None, None)) == 1.0


def test_nothing_is_compared_with_nothing() -> None:
    assert p_value(RIGHT, {}, right("r")) is p_value(RIGHT, right("r"), {}) is None
