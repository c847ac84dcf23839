"""The replay of recorded evidence: numbers small enough to check by hand."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.evidence_model.models import BEST_FIT
from benchmarks.evidence_model.records import ELSEWHERE_POSES, Record, load, save
from benchmarks.evidence_model.replay import Rules, Stack

EXACT = Rules(transition_probability=0.0)


def record(evidence: list[list[float]], **changed: Any) -> Record:
    """Two places, of which the first is right; half a metre a step."""
    steps, places = np.shape(evidence)
    reported = {
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
    return Record(**{**reported, **changed})


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


def test_elsewhere_takes_part_in_bayes_rule_against_all_places_together() -> None:
    lifted = record([[0.0, 0.0]], elsewhere=np.full((1, 3), math.log(9.0)))
    rules = Rules(elsewhere_hazard=0.1, transition_probability=0.0, elsewhere_view_m=1e-9)
    elsewhere = Stack([lifted]).replayed(rules).elsewhere
    np.testing.assert_allclose(elsewhere, [[0.0, 0.5]], atol=1e-9)  # 0.1 * 9 against 0.9 * 1


def test_the_first_sure_and_right_step_is_found() -> None:
    found, never = record([[0.0, 0.0], [5.0, 0.0]]), record([[0.0, 5.0], [0.0, 5.0]])
    replayed = Stack([found, never]).replayed(EXACT)
    assert list(replayed.sure_right_from) == [2.0, np.inf]
    assert replayed.sure_wrong.tolist() == [[False] * 3, [False, True, True]]


def test_records_come_back_from_their_file(tmp_path: Path) -> None:
    made = record([[0.0, np.nan]], kidnapped_at=7)
    save([made, made], tmp_path / "a.npz")
    _, again = load(tmp_path / "a.npz")
    assert (again.experiment, again.kidnapped_at) == ("made up", 7)
    np.testing.assert_array_equal(again.evidence, made.evidence)
    np.testing.assert_array_equal(again.into, made.into)
