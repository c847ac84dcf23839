"""Maps age as specified, and a run's figures are those of its beliefs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from benchmarks import aged_maps
from benchmarks.aged_maps import surface
from benchmarks.referee import outcomes, row_of, score
from benchmarks.referee_robots import CHANGES, Trial, begun
from benchmarks.worlds import world
from clustermcl.evaluation.measures import PoseError, ReportedPlace, StepFacts
from clustermcl.filter.arrays import FREE, OCCUPIED
from clustermcl.protocol.answers import State
from clustermcl.runtime.settings import Settings

HALL = world("hall").map
RIGHT, WRONG = PoseError(0.1, 0.0), PoseError(9.0, 0.0)


@pytest.mark.parametrize("change", sorted(CHANGES))
def test_a_change_alters_what_it_says_and_nothing_else(change: str) -> None:
    old, rng = HALL.cells, np.random.default_rng(1)
    new = CHANGES[change](HALL, rng).cells
    lost = np.mean(new[surface(old)] == FREE)
    gained = np.count_nonzero((old == FREE) & (new == OCCUPIED)) / np.count_nonzero(old == FREE)
    share = float(change.split()[1]) / 100 if change.startswith("moved") else 0.2
    removes = change.startswith(("moved", "missing", "aside"))
    assert lost == (pytest.approx(share, abs=0.06) if removes else 0.0)
    assert (gained > 0.0) == (change != "missing")
    assert not np.any((new == OCCUPIED) & ~(old == OCCUPIED) & ~(old == FREE)), "only free ground"
    if change == "aside":
        reach = round(0.5 / HALL.cell_m) + 1
        assert np.all(binary_dilation(old == OCCUPIED, iterations=2 * reach)[new == OCCUPIED])


def test_each_draw_has_changes_of_its_own() -> None:
    trial = Trial(row="given", robot="hall")
    first = [replace(trial, draw=draw).rng.integers(2**60) for draw in ("", "", "a", "b")]
    assert first[0] == first[1]
    assert len(set(first)) == 3


def test_new_furniture_leaves_the_path_clear_and_ends_beams_before_old_walls() -> None:
    trial = Trial(row="", robot="hall", number=1, steps=6, change="")
    grid_map, steps = begun(trial, None)
    path = [truth for _, truth in steps if truth is not None]
    placed = aged_maps.furniture(grid_map, 0.06, path, np.random.default_rng(3))
    free = grid_map.cells == FREE
    assert placed.sum() / free.sum() == pytest.approx(0.06, abs=0.01)
    at = np.argwhere(placed)[:, ::-1] * grid_map.cell_m + np.array(grid_map.map_from_grid[:2])
    away_m = min(np.hypot(*(at - truth[:2]).T).min() for truth in path)
    assert away_m > 0.5 - grid_map.cell_m
    changed = aged_maps.seen_with_furniture(steps, grid_map, placed, np.random.default_rng(4))
    nearer = 0
    for (before, _), (after, _) in zip(steps, changed, strict=True):
        old, new = before.ranges.array(), after.ranges.array()
        is_changed = (old != new) & ~(np.isinf(old) & np.isinf(new))
        assert np.all(new[is_changed] < old[is_changed])
        nearer += np.count_nonzero(is_changed)
    assert 0 < nearer < 0.7 * sum(len(scan.ranges.array()) for scan, _ in steps)


def facts(state: State, *places: tuple[float, PoseError]) -> StepFacts:
    reported = tuple(ReportedPlace(*place) for place in places)
    return StepFacts(0, 0, state, (0.0, 0.0, 0.0), reported, 0.0, 0.0)


def test_the_score_counts_sure_and_lost_steps_by_whether_they_are_right() -> None:
    made = score(
        [
            facts("localized", (0.95, RIGHT)),
            facts("localized", (0.95, WRONG), (0.04, RIGHT)),
            facts("lost", (0.2, RIGHT)),
            facts("lost", (0.2, WRONG)),
            facts("searching", (0.99, RIGHT)),
        ]
    )
    assert (made.sure_right, made.sure_wrong, made.localized) == (0.2, 0.2, 0.4)
    assert (made.lost, made.lost_right, made.tracked) == (0.4, 0.2, False)
    assert made.rmse_m == pytest.approx(math.sqrt((2 * 0.1**2 + 2 * 9.0**2) / 4))
    other = score([facts("localized", (0.95, RIGHT))])
    assert row_of([made, other], on_map=True).startswith(" **60.0** / 10.0 / 20.0 (10.0), 1 of 2")
    assert row_of([made, other], on_map=False) == " localized 70.0, worst 100; lost 20 |"


@pytest.mark.parametrize("algorithm", ["ours", "mcl"])
def test_a_given_pose_is_the_belief_of_the_first_step(algorithm: str) -> None:
    for begin, off_m in (("given", (0.2, 0.2)), ("wrong", (5.0, math.inf))):
        trial = Trial(row="", robot="hall", number=1, steps=2, begin=begin)
        _, (after, truth) = outcomes(trial, algorithm, Settings(), None)
        assert truth is not None
        away_m = math.dist(after.hypotheses[0].pose[:2], truth[:2])
        assert off_m[0] - 0.5 < away_m < off_m[1] + 0.5


def test_people_only_cut_beams_short() -> None:
    alone, among = (
        begun(Trial(row="", robot="hall", number=1, steps=3, people=people), None)[1]
        for people in (0, 20)
    )
    for (scan, truth), (cut, same) in zip(alone, among, strict=True):
        assert same == truth
        assert cut.odom_from_robot == scan.odom_from_robot
    nearer = among[-1][0].ranges.array() < alone[-1][0].ranges.array() - 0.5
    assert 0.05 < np.mean(nearer) < 0.8
