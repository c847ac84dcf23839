"""The replay of recorded evidence: numbers small enough to check by hand."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.evidence_model.models import BEST_FIT, Sloped, Tempered
from benchmarks.evidence_model.records import ELSEWHERE_POSES, Record, load, save
from benchmarks.evidence_model.replay import Rules, Stack

EXACT = Rules(transition_probability=0.0)


def record(evidence: list[list[float]], **changed: Any) -> Record:
    """Two places, of which the first is right; half a metre a step."""
    steps, places = np.shape(evidence)
    told = {
        "experiment": "made up",
        "seed": 0,
        "start_step": 0,
        "share": np.full(places, 1.0 / places),
        "first_fit": BEST_FIT,
        "planted": -1,
        "evidence": np.array(evidence),
        "fit": np.full((steps, places), BEST_FIT),
        "copy": np.tile(np.array([0] + [-1] * (places - 1), np.int8), (steps, 1)),
        "ess": np.ones((steps, places)),
        "into": np.tile(np.arange(places, dtype=np.int16), (steps, 1)),
        "distance_m": np.full(steps, 0.5),
        "turn_rad": np.zeros(steps),
        "beams": np.full(steps, 60, np.int16),
        "known": np.ones(steps, bool),
        "elsewhere": np.full((steps, len(ELSEWHERE_POSES)), -20.0),
        "elsewhere_fit": np.zeros((steps, len(ELSEWHERE_POSES))),
    }
    return Record(**{**told, **changed})


def test_evidence_in_full_is_bayes_rule() -> None:
    replayed = Stack([record([[math.log(3.0), 0.0], [0.0, math.log(2.0)]])]).replayed(EXACT)
    np.testing.assert_allclose(replayed.truth, [[1 / 2, 3 / 4, 3 / 5]])
    np.testing.assert_allclose(replayed.brier[0, 1], 2 * (1 / 4) ** 2)
    np.testing.assert_allclose(replayed.log_score, np.log(replayed.truth))


def test_runs_of_different_length_do_not_mix() -> None:
    short, long = record([[1.0, 0.0]]), record([[0.0, 1.0, 0.0]] * 3)
    both = Stack([short, long]).replayed(EXACT)
    for row, alone in enumerate((short, long)):
        truth = Stack([alone]).replayed(EXACT).truth[0]
        np.testing.assert_allclose(both.truth[row, : len(truth)], truth)
    assert np.isnan(both.truth[0, 2:]).all()
    assert not both.sure_wrong[0, 2:].any()


def test_a_merged_place_gives_what_it_has_to_the_other() -> None:
    into = np.array([[0, 0, 2], [0, 1, 2]], np.int16)
    merged = record([[0.0, 0.0, 0.0], [math.log(2.0), np.nan, 0.0]], into=into)
    truth = Stack([merged]).replayed(EXACT).truth
    np.testing.assert_allclose(truth, [[1 / 3, 1 / 3, 4 / 5]])


def test_the_transition_gives_every_place_its_part() -> None:
    rules = Rules(transition_probability=0.5, counted=lambda worse, *_: 0.0 * worse)
    uneven = record([[0.0, 0.0]], share=np.array([0.8, 0.2]))
    # The first scan counts as nothing by these rules, so both places begin alike.
    np.testing.assert_allclose(Stack([uneven]).replayed(rules).truth, [[0.5, 0.5]])
    spread = Rules(transition_probability=0.5)
    np.testing.assert_allclose(Stack([uneven]).replayed(spread).truth, [[0.8, 0.65]])


def test_elsewhere_takes_part_in_bayes_rule_against_all_places_together() -> None:
    lifted = record([[0.0, 0.0]], elsewhere=np.full((1, 3), math.log(9.0)))
    rules = Rules(elsewhere_hazard=0.1, transition_probability=0.0, elsewhere_view_m=1e-9)
    elsewhere = Stack([lifted]).replayed(rules).elsewhere
    np.testing.assert_allclose(elsewhere, [[0.0, 0.5]], atol=1e-9)  # 0.1 * 9 against 0.9 * 1


def test_where_no_place_is_right_elsewhere_is_the_truth() -> None:
    nowhere = record([[0.0, 0.0]], copy=np.full((1, 2), -1, np.int8))
    rules = Rules(elsewhere_hazard=0.2, elsewhere_view_m=1e9)
    replayed = Stack([nowhere]).replayed(rules)
    np.testing.assert_allclose(replayed.truth[0, 1], 0.2, atol=1e-6)
    np.testing.assert_allclose(replayed.truth, replayed.elsewhere)


def test_the_first_sure_and_right_step_is_found() -> None:
    found, never = record([[0.0, 0.0], [5.0, 0.0]]), record([[0.0, 5.0], [0.0, 5.0]])
    replayed = Stack([found, never]).replayed(EXACT)
    assert list(replayed.sure_right_from) == [2.0, np.inf]
    assert replayed.sure_wrong.tolist() == [[False] * 3, [False, True, True]]


def test_copies_of_the_truth_stay_even_or_do_not() -> None:
    alike = record([[0.0, 0.0], [math.log(3.0), 0.0]], copy=np.array([[0, 1], [0, 1]], np.int8))
    replayed = Stack([alike]).replayed(EXACT)
    uneven = -(0.75 * math.log2(0.75) + 0.25 * math.log2(0.25))
    np.testing.assert_allclose(replayed.entropy, [(1.0 + 1.0 + uneven) / 3.0])
    assert np.isnan(Stack([record([[0.0, 0.0]])]).replayed(EXACT).entropy).all()


def test_a_standing_robot_gathers_nothing() -> None:
    model, fits = Tempered(0.8, 1.6), np.array([[BEST_FIT]])
    stood, driven, first = (
        model(np.array([[2.0]]), fits, np.array([[way]]), np.zeros((1, 1)))
        for way in (0.0, 0.8 * math.log(2.0), np.inf)
    )
    assert (stood.item(), first.item()) == (0.0, 2.0)
    assert driven.item() == pytest.approx(1.0)


def test_unexplained_beams_and_near_likeness_count_less() -> None:
    model, far = Tempered(0.8, 1.6, 0.25, 1.0), np.full((1, 1), np.inf)
    fitting = model(np.array([[1.0]]), np.array([[BEST_FIT]]), far, far)
    crowded = model(np.array([[1.0]]), np.array([[BEST_FIT - 0.25]]), far, far)
    assert (fitting.item(), crowded.item()) == (0.5, 0.25)


def test_a_slope_counts_whole_beyond_its_knee() -> None:
    np.testing.assert_allclose(Sloped(0.2, 3.0)(np.array([1.0, 3.0, 5.0])), [0.2, 0.6, 2.6])
    np.testing.assert_allclose(Sloped(1.0, 0.0, 0.2)(np.array([0.1, 5.0])), [0.1, 0.2])


def test_records_come_back_from_their_file(tmp_path: Path) -> None:
    made = record([[0.0, np.nan]], kidnapped_at=7)
    save([made, made], tmp_path / "a.npz")
    _, again = load(tmp_path / "a.npz")
    assert (again.experiment, again.kidnapped_at) == ("made up", 7)
    np.testing.assert_array_equal(again.evidence, made.evidence)
    np.testing.assert_array_equal(again.into, made.into)
