import math
from functools import cache

import numpy as np
import pytest

from clustermcl.filter.arrays import Cells
from clustermcl.filter.cluster.gaussian import share_near_mean
from tests.unit.oracle.grid_filter import Array, assert_is_mean_of
from tests.unit.oracle.tiny_world import (
    DRIVE,
    MIRRORED,
    PATCH_CELL,
    TRUTH,
    Drive,
    ensemble_steps,
    exact_elsewhere,
    exact_evidence,
    exact_patch,
    plain_room,
    settings,
    symmetric_room,
)

MOVED_M, TURNED_RAD = math.hypot(DRIVE[0], DRIVE[1]), float(DRIVE[2])
STEPS, SEEDS = 6, range(16)
GRID_ERROR = 0.02
"""Of a log ratio over all steps: a place and its mirror image differ by 0.016, finer grids less."""
NEARBY = TRUTH + np.array([0.25, -0.1, 0.05])
"""Near enough to the truth to be merged with it."""
ROOMS = {"plain": plain_room, "symmetric": symmetric_room}
PLACES = {"truth": TRUTH, "mirrored": MIRRORED, "beside": NEARBY}


@cache
def drive(room: str) -> Drive:
    return Drive(ROOMS[room](), TRUTH, STEPS)


@cache
def evidence(room: str, place: str) -> Array:
    """(steps,) exact log evidence of one place, or of all others."""
    if place == "elsewhere":
        return np.array(exact_elsewhere(ROOMS[room](), drive(room)))
    return np.array(exact_evidence(ROOMS[room](), drive(room), exact_patch(PLACES[place])))


def log_odds(
    room: str,
    first: dict[str, float],
    *,
    missing: dict[int, str] | None = None,
    reach_m: float = 0.2,
    **belief: object,
) -> list[list[float]]:
    """By seed, the log odds of the others against the first cluster after the last step.

    Elsewhere comes last, where the robot may be lifted.
    """
    cells: Cells = ROOMS[room]()
    found = [(share, PLACES[place]) for place, share in first.items()]
    odds = []
    for seed in SEEDS:
        given = settings(seed, reach_m=reach_m, **belief)
        *_, (outcome, _) = ensemble_steps(cells, drive(room), found, given, missing=missing)
        reported = [each.probability for each in outcome.hypotheses]
        assert math.fsum([*reported, outcome.elsewhere_probability]) == pytest.approx(1.0)
        lifted = given.belief.kidnapping_probability > 0.0
        logs, beyond = {}, 0.0
        for each in outcome.hypotheses:  # the exact filter's places have no bound
            share = share_near_mean(each.covariance, *given.search.reach) if lifted else 1.0
            logs[each.cluster] = each.log_probability - math.log(share)
            beyond += math.exp(logs[each.cluster]) - each.probability
        others = [logs[cluster] for cluster in sorted(logs)[1:]]
        if lifted:
            others.append(math.log(outcome.elsewhere_probability - beyond))
        odds.append([other - logs[0] for other in others])
    return odds


def exact_log_odds(
    logs: Array, evidence_of: Array, *, hazard: float = 0.0, missing: dict[int, int] | None = None
) -> Array:
    """Bayes' rule over the places, in plain numbers; (K - 1,) log odds against the first.

    With a hazard of being lifted before a step, the last of the (K,) logs is elsewhere. `missing`
    has, by step from 1, the place without a report.
    """
    here = np.exp(logs) / np.exp(logs).sum()
    here, there = (here[:-1], here[-1]) if hazard > 0.0 else (here, 0.0)
    for step in range(evidence_of.shape[1]):
        there += hazard * here.sum()
        here *= 1.0 - hazard
        reported = np.full(len(here), True)
        if missing and step + 1 in missing:
            reported[missing[step + 1]] = False
        gain, mass = evidence_of[: len(here)][reported, step], here[reported].sum()
        scan = (here[reported] * np.exp(gain)).sum() / mass
        fresh = here[reported] * np.exp(gain - gain.max())
        here[reported] = mass * fresh / fresh.sum()
        if hazard > 0.0:
            there *= np.exp(evidence_of[-1, step]) / scan
    others = [*here[1:], there] if hazard > 0.0 else here[1:]
    return np.asarray(np.log(np.array(others) / here[0]))


def assert_agrees(shares: dict[str, float], *, missing: dict[int, int] | None = None) -> None:
    """Compare the log odds after all steps from these probabilities; elsewhere comes last."""
    hazard = 0.02 if "elsewhere" in shares else 0.0
    exact = exact_log_odds(
        np.log(list(shares.values())),
        np.stack([evidence("plain", place) for place in shares]),
        hazard=hazard,
        missing=missing,
    )
    tracked = {place: share for place, share in shares.items() if place != "elsewhere"}
    lost = {step: f"c{cluster}" for step, cluster in (missing or {}).items()}
    reach_m = 0.2 if hazard else 1e-9  # those beside each other do not merge
    found = log_odds("plain", tracked, missing=lost, reach_m=reach_m, kidnapping_probability=hazard)
    for expected, odds in zip(exact, zip(*found, strict=True), strict=True):
        assert_is_mean_of(expected, odds, GRID_ERROR)


@pytest.mark.parametrize(
    "shares",
    [
        {"mirrored": 0.6, "truth": 0.4},
        {"truth": 0.5, "mirrored": 0.3, "elsewhere": 0.2},
        {"mirrored": 0.9, "elsewhere": 0.1},
    ],
    ids=["a better place", "elsewhere", "the true place is not tracked"],
)
def test_probabilities_agree_with_the_exact_filter(shares: dict[str, float]) -> None:
    assert_agrees(shares)


def test_two_places_that_look_alike_stay_alike() -> None:
    exact = evidence("symmetric", "truth").sum() - evidence("symmetric", "mirrored").sum()
    assert exact == pytest.approx(0.0, abs=GRID_ERROR)
    found = [odds[0] for odds in log_odds("symmetric", {"truth": 0.5, "mirrored": 0.5})]
    assert_is_mean_of(0.0, found, 0.0)
    assert max(abs(odds) for odds in found) < 0.3, "not in the mean only"


@pytest.mark.parametrize("third", ["beside", "elsewhere"])
def test_a_place_without_a_report_keeps_its_probability(third: str) -> None:
    """Elsewhere is compared with the average over the places that reported, not with their sum."""
    assert_agrees({"truth": 0.4, "mirrored": 0.35, third: 0.25}, missing={2: 1, STEPS: 0})


def test_mean_and_covariance_of_a_cluster_agree_with_the_exact_grid() -> None:
    patch = exact_patch(TRUTH)
    exact_evidence(plain_room(), drive("plain"), patch)
    mean, covariance = patch.gaussian()
    means, covariances = [], []
    for seed in SEEDS:
        found = ensemble_steps(plain_room(), drive("plain"), [(1.0, TRUTH)], settings(seed))
        *_, (_, reports) = found
        means.append(np.array(reports["c0"].pose))
        covariances.append(np.reshape(reports["c0"].covariance, (3, 3)))
    sigma = np.sqrt(np.diag(covariance))
    for i in range(3):
        assert_is_mean_of(mean[i], [m[i] for m in means], 0.03 * sigma[i])
        for j in range(3):
            # A twelfth of a cell's square is in a variance of the grid, and not of particles.
            cell = PATCH_CELL[i] ** 2 / 12.0 if i == j else 0.0
            found_ij = [float(c[i, j]) for c in covariances]
            assert_is_mean_of(covariance[i, j] - cell, found_ij, 0.05 * sigma[i] * sigma[j] + cell)
