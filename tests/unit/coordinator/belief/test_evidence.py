import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.search_pool import KEPT_STEPS, SearchPool
from clustermcl.filter.cluster.view_memory import ViewMemory
from clustermcl.filter.laser.evidence_model import residual
from clustermcl.filter.settings import SearchSettings, SensorSettings
from tests.unit.coordinator.belief.test_ensemble import (
    EAST,
    NORTH,
    SOUTH,
    bootstrapped,
    probabilities,
)
from tests.unit.coordinator.reports import found_places, resumed, searched, tracked


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
    leaking = bootstrapped(first, transition_probability=0.2).advance(1, reports)
    assert probabilities(leaking)[0] == pytest.approx(0.8 * 1.8 / 2.2 + 0.1)
    same = {NORTH: 0.5, SOUTH: 0.5}
    bad = residual(-1.0, SensorSettings())
    half = bootstrapped(same, evidence_residual=bad).advance(1, reports)
    assert probabilities(half)[0] == pytest.approx(1.0 / (1.0 + 3.0**-0.5))
    moved = np.array([math.log(2.0), 0.0, 0.0])
    again = bootstrapped(same, view_distance_m=1.0).advance(1, reports, moved)
    assert probabilities(again)[0] == pytest.approx(1.0 / (1.0 + 3.0**-0.5), rel=0.01)


def test_shards_views_of_one_place_count_by_their_share_and_evidence() -> None:
    """Both shards found it; the first with 4 points, the second with 2 of three times the
    evidence."""
    pool = SearchPool(0, 0, SearchSettings(shards=2))
    for job_id, evidence, x_m, count in (("s0.0", 1.0, 1.0, 4), ("s0.1", 3.0, 1.2, 2)):
        report = searched(job_id, 0, {}, log_evidence=math.log(evidence))
        found = [(0.8, (x_m, 0.0, 0.0)), (0.2, (9.0 + x_m, 0.0, 0.0))]
        pool.add(replace(report, places=found_places(found, count)))
    pooled = pool.pooled()
    assert pooled.share == pytest.approx((0.8, 0.2))
    near = pooled.place(0, 0.5)
    assert near.share == 0.5
    sample = near.sample
    poses, logs = sample.map_from_robot.array(), sample.log_weights.array()
    weights = np.exp(logs - np.logaddexp.reduce(logs))
    of_second = float(weights[poses[:, 0] > 1.1].sum())
    assert of_second == pytest.approx(0.75), "by evidence, whatever the number of points"
    assert near.pose[0] == pytest.approx(1.2), "the pose of the shard with the larger share"
    assert pool.finished(pooled, 2)
    assert not pool.finished(pooled, 1)


@pytest.mark.parametrize(("weight", "gap"), [(1.0, 1.0), (0.05, 1.0), (1e-4, 7.0)])
def test_places_that_a_shard_without_weight_left_out_are_not_used(
    weight: float, gap: float
) -> None:
    """The least gap of those that have found something: a search ends when it is large."""
    pool = SearchPool(0, 0, SearchSettings(shards=3))
    for shard, (evidence, left_out) in enumerate([(1.0, 9.0), (weight, 1.0), (1.0, 7.0)]):
        log_evidence = math.log(evidence)
        report = searched(
            f"s0.{shard}", 0, {NORTH: 1.0}, log_evidence=log_evidence, left_out_gap=left_out
        )
        pool.add(report)
    pooled = pool.pooled()
    assert pooled.left_out_gap == gap


def test_only_a_step_that_all_shards_have_reached_is_pooled() -> None:
    pool = SearchPool(0, 0, SearchSettings(shards=2))
    pool.add(searched("s0.0", 3, {NORTH: 1.0}))
    assert pool.pooled() is None
    for step in (4, 5):
        for shard in range(2):
            pool.add(searched(f"s0.{shard}", step, {NORTH: 1.0}))
    pool.add(searched("s0.0", 6, {NORTH: 1.0}))
    newest = pool.pooled()
    assert newest.step == 5
    assert pool.pooled() is None, "once is enough"
    pool.add(searched("s0.1", 6, {NORTH: 1.0}))
    newest = pool.pooled()
    assert newest.step == 6


def test_shards_that_a_full_processor_lets_run_far_apart_still_meet() -> None:
    """The fast one's reports on the steps that the slow one reached were gone: no search ended."""
    pool, pooled, ahead = SearchPool(0, 0, SearchSettings(shards=2)), list[int](), 40
    for step in range(3 * ahead):
        pool.add(searched("s0.0", step, {NORTH: 1.0}))
        if step >= ahead:
            pool.add(searched("s0.1", step - ahead, {NORTH: 1.0}))
        assert len(pool.reports) <= KEPT_STEPS
        if (found := pool.pooled()) is not None:
            pooled.append(found.step)
    assert pooled[0] == 0
    assert pooled[-1] > ahead
    pool.add(searched("s0.1", 0, {NORTH: 1.0}))  # another worker begins it again
    for step in range(ahead, 3 * ahead):
        pool.add(searched("s0.1", step, {NORTH: 1.0}))
    pool.add(searched("s0.0", 3 * ahead, {NORTH: 1.0}))
    pool.add(searched("s0.1", 3 * ahead, {NORTH: 1.0}))
    found = pool.pooled()
    assert found is not None
    assert found.step == 3 * ahead


@pytest.mark.parametrize(("patient", "over"), [(True, [False, False, True]), (False, [True] * 3)])
def test_a_search_takes_longer_while_more_is_possible_than_can_be_tracked(
    patient: bool, over: list[bool]
) -> None:
    pool = SearchPool(0, 10, SearchSettings(shards=1, max_steps=3))
    ended = []
    for step in (12, 20, 21):
        pool.add(searched("s0.0", step, {NORTH: 0.4, SOUTH: 0.3, (9.0, 0.0, 0.0): 0.3}))
        found = pool.pooled()
        assert found is not None
        ended.append(pool.finished(found, 2, patient=patient))
    assert ended == over


TURN = np.array([0.0, 0.0, 2.0 * math.pi / 31.0])


def turned(made: Ensemble, first_step: int, turns: int) -> dict[int, float]:
    """After a robot at one of two places has turned on the spot: each scan favours c1."""
    for step in range(first_step, first_step + 31 * turns):
        reports = [tracked("c0", step, 0.25, NORTH), tracked("c1", step, 0.5, SOUTH)]
        outcome = made.advance(step, reports, TURN)
    return probabilities(outcome)


def two_places() -> Ensemble:
    return bootstrapped({NORTH: 0.5, SOUTH: 0.5}, view_distance_m=0.8, search_every_steps=10_000)


def test_a_view_counts_once_however_often_the_robot_turns() -> None:
    made = two_places()
    once = turned(made, 1, 1)
    assert 0.03 < once[0] < 0.3
    assert turned(made, 32, 14)[0] == pytest.approx(once[0], rel=0.2)


def test_seen_views_are_transferred_with_the_belief() -> None:
    made = two_places()
    turned(made, 1, 1)
    other = resumed(made)
    assert turned(other, 32, 1) == turned(made, 32, 1)
    other.seen = ViewMemory()
    assert turned(other, 63, 1)[0] < 0.5 * turned(made, 63, 1)[0]


def with_a_third_place(seen_steps: int) -> tuple[Ensemble, int]:
    """Two places and one that a search has found after these steps on the spot; and the step."""
    made = bootstrapped(
        {NORTH: 0.5, SOUTH: 0.5}, view_distance_m=0.8, search_every_steps=seen_steps,
        candidate_probability=0.5,
    )  # fmt: skip
    turned(made, 1, seen_steps // 31)
    step = seen_steps + 1
    found = [searched(f"s1.{shard}", step, {EAST: 1.0}) for shard in range(2)]
    assert len(made.advance(step, found, TURN).hypotheses) == 3
    return made, step


def test_a_new_place_has_no_seen_views() -> None:
    """Further scans separate it from others, even after the robot has turned there."""
    made, step = with_a_third_place(31)
    reported = []
    for later in (step + 1, step + 2):
        reports = [tracked("c1", later, 0.25, SOUTH), tracked("c2", later, 0.5, EAST)]
        reported.append(probabilities(made.advance(later, reports, TURN))[2])
    assert reported[1] > reported[0] > 1 / 3


def test_the_scan_by_which_a_place_was_found_is_not_used_twice() -> None:
    """Where candidates came step after step, each scan counted in full."""
    made, step = with_a_third_place(31)
    before = made.clusters
    north, south = (before.clusters[number].log_probability for number in (0, 1))
    reports = [tracked("c0", step + 1, 0.25, NORTH), tracked("c1", step + 1, 0.5, SOUTH)]
    after = probabilities(made.advance(step + 1, reports, TURN))
    gained = math.log(after[1] / after[0]) - (south - north)
    view = 1.0 - math.exp(-TURN[2] / two_places().settings.belief.view_turn_rad)
    assert gained == pytest.approx(view * math.log(2.0), rel=0.02)
