"""What reports do to the belief: averages, missing ones, being lost, shares of what is found."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from coordinator.belief.fit_monitor import FitMonitor
from coordinator.belief.search_pool import SearchPool
from particle_filter.settings import BeliefSettings, SearchSettings
from protocol.arrays import ArrayBlob
from protocol.work import Particles, Place
from tests.unit.coordinator.belief.test_ensemble import (
    EAST,
    NORTH,
    SOUTH,
    bootstrapped,
    probabilities,
)
from tests.unit.coordinator.reports import place, searched, tracked


def test_the_number_of_particles_is_no_evidence() -> None:
    """Ten times the particles have ten times the sum of weights, and the same average."""
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5})
    many = tracked("c1", 1, 0.1, SOUTH)
    many = replace(
        many, particles=many.particles * 10, log_weight_sum=many.log_weight_sum + math.log(10.0)
    )
    outcome = made.advance(1, [tracked("c0", 1, 0.1, NORTH), many])
    assert probabilities(outcome) == pytest.approx({0: 0.5, 1: 0.5})


def test_the_settings_of_the_belief_reach_its_update() -> None:
    reports = [tracked("c0", 1, 0.3, NORTH), tracked("c1", 1, 0.1, SOUTH)]
    first = {NORTH: 0.6, SOUTH: 0.4}
    squared = bootstrapped(first, squared_prior=True).advance(1, reports)
    assert probabilities(squared)[0] == pytest.approx(0.36 * 3 / (0.36 * 3 + 0.16))
    leaking = bootstrapped(first, transition_probability=0.2).advance(1, reports)
    assert probabilities(leaking)[0] == pytest.approx(0.8 * 1.8 / 2.2 + 0.1)
    # Large enough not to lift the first shares, 0.5 each.
    bound = bootstrapped({NORTH: 0.5, SOUTH: 0.5}, evidence_bound=0.5).advance(1, reports)
    assert probabilities(bound)[0] == pytest.approx(1.0 / (1.0 + math.exp(-0.5)))


def test_a_robot_is_lost_when_no_cluster_fits_and_not_when_one_does_not() -> None:
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5})
    for step in range(1, 20):
        fits = {"c0": (NORTH, -1.0), "c1": (SOUTH, -1.0 if step < 5 else -9.0)}
        reports = [tracked(job, step, 0.1, at, fit=fit) for job, (at, fit) in fits.items()]
        assert made.advance(step, reports).state == "ambiguous"
    states = []
    for step in range(20, 24):
        reports = [tracked("c0", step, 0.1, NORTH, fit=-9.0)]
        reports.append(tracked("c1", step, 0.1, SOUTH, fit=-9.0))
        states.append(made.advance(step, reports).state)
    assert states[-1] == "lost"


def test_lost_begins_at_the_drop_and_ends_at_half_of_it() -> None:
    rules = BeliefSettings(lost_fit_drop=1.0, recent_fit_gain=1.0, usual_fit_gain=0.5)
    fit = FitMonitor(rules)
    said = []
    for value in (-1.0, -1.9, -2.6, -2.1, -1.94, -math.nan, -2.4):
        fit.update(value)
        said.append(fit.lost)
    # The usual fit: -1, then half way to -1.9 is -1.45; 1.15 below that is lost, and while it is
    # lost nothing becomes usual. 0.65 below is lost still, 0.49 is not: then -1.695 is usual.
    assert said == [False, False, True, True, False, False, False]
    state = fit.state()
    assert state.usual == pytest.approx((-1.695 - 2.4) / 2)
    assert state.recent == -2.4
    again = FitMonitor(rules)
    again.restore(state)
    assert again.state() == state
    assert again.is_usual(state.usual - 0.49)
    assert not again.is_usual(state.usual - 0.51)


def seen(share: float, x_m: float, step: int, count: int) -> Place:
    """A place with `count` points of even weight."""
    at = place(share, (x_m, 0.0, 0.0), step)
    sample = Particles(
        step=step,
        odom_from_robot=(0.0, 0.0, 0.0),
        map_from_robot=ArrayBlob.of(np.tile([x_m, 0.0, 0.0], (count, 1)), "float32"),
        log_weights=ArrayBlob.of(np.zeros(count), "float32"),
    )
    return replace(at, sample=sample)


def test_shards_views_of_one_place_count_by_their_share_and_evidence() -> None:
    """Both shards found it; the first with 4 points, the second with 2 of thrice the evidence."""
    pool = SearchPool(0, 0, SearchSettings(shards=2))
    for job_id, evidence, x_m, count in (("s0.0", 1.0, 1.0, 4), ("s0.1", 3.0, 1.2, 2)):
        report = searched(job_id, 0, {}, log_evidence=math.log(evidence))
        pool.add(replace(report, places=(seen(0.8, x_m, 0, count), seen(0.2, 9.0 + x_m, 0, count))))
    pooled = pool.pooled()
    assert pooled is not None
    near, far = pooled.places
    assert (near.share, far.share) == pytest.approx((0.8, 0.2))
    poses, logs = near.sample.map_from_robot.array(), near.sample.log_weights.array()
    weights = np.exp(logs - np.logaddexp.reduce(logs))
    of_second = float(weights[poses[:, 0] > 1.1].sum())
    assert of_second == pytest.approx(0.75), "by evidence, whatever the number of points"
    assert near.mean[0] == pytest.approx(1.2), "as the shard has it that says more of it"
    assert pool.finished(pooled, 2)
    assert not pool.finished(pooled, 1)


def test_only_a_step_that_all_shards_have_reached_is_pooled() -> None:
    pool = SearchPool(0, 0, SearchSettings(shards=2))
    pool.add(searched("s0.0", 3, {NORTH: 1.0}))
    assert pool.pooled() is None
    for step in (4, 5):
        for shard in range(2):
            pool.add(searched(f"s0.{shard}", step, {NORTH: 1.0}))
    pool.add(searched("s0.0", 6, {NORTH: 1.0}))
    newest = pool.pooled()
    assert newest is not None
    assert newest.step == 5


def test_a_search_that_takes_too_long_ends() -> None:
    pool = SearchPool(0, 10, SearchSettings(shards=1, max_steps=3))
    ended = []
    for step in (10, 11, 12):
        pool.add(searched("s0.0", step, {NORTH: 0.4, SOUTH: 0.3}))
        found = pool.pooled()
        assert found is not None
        ended.append(pool.finished(found, 2))
    assert ended == [False, False, True]


def test_first_places_are_lifted_by_the_bound_of_each_step_of_the_search() -> None:
    places = {NORTH: 0.9, SOUTH: 0.0999, EAST: 0.0001}
    outcome = bootstrapped(places, evidence_bound=3.0).again(0, ())
    shares = np.array([0.9, 0.0999, 0.9 * math.exp(-3.0)])
    expected = shares / shares.sum()
    assert probabilities(outcome) == pytest.approx(dict(enumerate(expected)))
