import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.filter.settings import FilterSettings, SearchSettings
from tests.unit.filter.naive_rays import composed
from tests.unit.oracle.grid_filter import Array, ExactField
from tests.unit.oracle.statistics import assert_is_mean_of
from tests.unit.oracle.tiny_world import (
    CELL_M,
    DRIVE,
    MIRRORED,
    MOTION,
    SENSOR,
    TRUTH,
    Drive,
    ensemble_steps,
    exact_elsewhere,
    exact_everywhere,
    exact_evidence,
    exact_patch,
    plain_room,
    settings,
)

STEPS, SEEDS, HAZARD = 2, range(16), 0.1
FIRST = 2
"""The step after the one at which the search is decided on."""
REACH_M, REACH_RAD = 0.8, 0.6
"""Of a place round its source point: all that is left of the belief about it lies within."""
GRID_ERROR = 0.03
SEARCH = SearchSettings(
    source_radius_m=REACH_M,
    source_heading_rad=REACH_RAD,
    min_place_share=0.0,
    converged_mass=0.99999,
    max_steps=STEPS - FIRST + 1,
)


def searching(seed: int, shards: int) -> FilterSettings:
    """A search begins at every step at which none runs; its places have to earn their weight."""
    rules = settings(
        seed, search_every_steps=1, kidnapping_probability=HAZARD, candidate_probability=0.0
    )
    return replace(rules, search=replace(SEARCH, shards=shards))


def at_last() -> Array:
    """Where the robot truly is in the end."""
    truth: Array = TRUTH
    for _ in range(STEPS):
        truth = composed(truth, DRIVE)
    return truth


def exact_log_odds(drive: Drive) -> float:
    """Of the true place, found by the search, against the cluster that was tracked all along."""
    cells = plain_room()
    gathered = np.array(exact_evidence(cells, drive, exact_patch(MIRRORED)))
    elsewhere = exact_elsewhere(cells, drive)
    # Before step 1 the cluster is certain; then it is the hazard that makes elsewhere possible.
    start = math.log(HAZARD) - math.log1p(-HAZARD) + (elsewhere[0] - gathered[0])
    since = math.log1p(-HAZARD) * (STEPS - 1) + float(gathered[1:].sum())
    return start + exact_log_weight(drive) - since


def exact_log_weight(drive: Drive) -> float:
    """Log of the evidence of the search's scans times the share of it at the true place."""
    cells = plain_room()
    field, grid, log_evidence = ExactField(cells, CELL_M, SENSOR), exact_everywhere(cells), 0.0
    truth = at_last()
    for step in range(FIRST, STEPS + 1):
        if step > FIRST:
            grid.move(DRIVE, MOTION)
        log_evidence += grid.weigh(field, drive.hits[step - 1], SENSOR.scan_likelihood_exponent)
    near = np.hypot(grid.x - truth[0], grid.y - truth[1]) < REACH_M
    turn = np.angle(np.exp(1j * (grid.heading - truth[2])))
    share = float(grid.mass[near & (np.abs(turn) < REACH_RAD)].sum())
    assert 0.1 < share < 0.999, "the places differ"
    return log_evidence + math.log(share)


@pytest.mark.parametrize("shards", [1, 3])
def test_the_probability_of_a_new_place_agrees_with_an_exact_filter(shards: int) -> None:
    """B(elsewhere) when the search began x its evidence x share, beside what is tracked.

    The search's evidence is the average of its shards', however many they are.
    """
    drive = Drive(plain_room(), TRUTH, STEPS)
    found = []
    for seed in SEEDS:
        steps = ensemble_steps(plain_room(), drive, [(1.0, MIRRORED)], searching(seed, shards))
        *_, (outcome, _) = steps
        logs = {h.cluster: h.log_probability for h in outcome.hypotheses}
        fresh = [h for h in outcome.hypotheses if h.age_steps == 0]
        (new,) = [h for h in fresh if np.all(np.abs(h.pose - at_last()) < 0.3)]
        found.append(new.log_probability - logs[0])
    assert_is_mean_of(exact_log_odds(drive), found, GRID_ERROR)
