import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.familiarity import FRONT, Familiarity, Learned
from clustermcl.belief.search_pool import KEPT_STEPS, SearchPool
from clustermcl.filter.laser.pieces import Pieces
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import BeliefSettings, FilterSettings, SearchSettings
from clustermcl.protocol.pose_arrays import pose_tuple
from tests.unit.coordinator.belief.test_ensemble import NORTH, SOUTH, bootstrapped, probabilities
from tests.unit.coordinator.reports import elsewhere, found_places, resumed, searched, tracked

RULES = SearchSettings()


def tracking(most: int, **search: int) -> FilterSettings:
    """With this many clusters at most."""
    return FilterSettings(belief=BeliefSettings(max_clusters=most), search=SearchSettings(**search))


def test_the_number_of_particles_is_no_evidence() -> None:
    """Ten times the particles have ten times the sum of weights, and the same average."""
    made = bootstrapped({NORTH: 0.5, SOUTH: 0.5})
    many = tracked("c1", 1, 0.1, SOUTH)
    many = replace(
        many, particles=many.particles * 10, log_weight_sum=many.log_weight_sum + math.log(10.0)
    )
    outcome = made.advance(1, [tracked("c0", 1, 0.1, NORTH), many])
    assert probabilities(outcome) == pytest.approx({0: 0.5, 1: 0.5})


def test_shards_views_of_one_place_count_by_their_share_and_evidence() -> None:
    """Both shards found it; the first with 4 points, the second with 2 of three times the
    evidence."""
    pool = SearchPool(("s0.0", "s0.1"), 0)
    for job_id, evidence, x_m, count in (("s0.0", 1.0, 1.0, 4), ("s0.1", 3.0, 1.2, 2)):
        report = searched(job_id, 0, {}, log_evidence=math.log(evidence))
        found = [(0.8, (x_m, 0.0, 0.0)), (0.2, (9.0 + x_m, 0.0, 0.0))]
        pool.add(replace(report, places=found_places(found, count)))
    pooled = pool.pooled(RULES)
    assert pooled.share == pytest.approx((0.8, 0.2))
    near = pooled.place(0, 0.5)
    assert near.share == 0.5
    sample = near.sample
    poses, logs = sample.map_from_robot.array(), sample.log_weights.array()
    weights = np.exp(logs - np.logaddexp.reduce(logs))
    of_second = float(weights[poses[:, 0] > 1.1].sum())
    assert of_second == pytest.approx(0.75), "by evidence, whatever the number of points"
    assert near.pose[0] == pytest.approx(1.2), "the pose of the shard with the larger share"
    assert pool.finished(pooled, tracking(2), patient=True)
    assert not pool.finished(pooled, tracking(1), patient=True)


@pytest.mark.parametrize(("weight", "gap"), [(1.0, 1.0), (0.05, 1.0), (1e-4, 7.0)])
def test_places_that_a_shard_without_weight_left_out_are_not_used(
    weight: float, gap: float
) -> None:
    """The least gap of those that have found something: a search ends when it is large."""
    pool = SearchPool(("s0.0", "s0.1", "s0.2"), 0)
    for shard, (evidence, left_out) in enumerate([(1.0, 9.0), (weight, 1.0), (1.0, 7.0)]):
        how = {"log_evidence": math.log(evidence), "left_out_gap": left_out}
        pool.add(searched(f"s0.{shard}", 0, {NORTH: 1.0}, **how))
    assert pool.pooled(RULES).left_out_gap == gap


def test_only_a_step_that_all_shards_have_reached_is_pooled() -> None:
    pool = SearchPool(("s0.0", "s0.1"), 0)
    pool.add(searched("s0.0", 3, {NORTH: 1.0}))
    assert pool.pooled(RULES) is None
    for step in (4, 5):
        for shard in range(2):
            pool.add(searched(f"s0.{shard}", step, {NORTH: 1.0}))
    pool.add(searched("s0.0", 6, {NORTH: 1.0}))
    assert pool.pooled(RULES).step == 5
    assert pool.pooled(RULES) is None, "once is enough"
    pool.add(searched("s0.1", 6, {NORTH: 1.0}))
    assert pool.pooled(RULES).step == 6


def test_shards_that_a_full_processor_lets_run_far_apart_still_meet() -> None:
    """The fast one's reports on the steps that the slow one reached were gone: no search ended."""
    pool, pooled, ahead = SearchPool(("s0.0", "s0.1"), 0), list[int](), 40
    for step in range(3 * ahead):
        pool.add(searched("s0.0", step, {NORTH: 1.0}))
        if step >= ahead:
            pool.add(searched("s0.1", step - ahead, {NORTH: 1.0}))
        assert len(pool.reports) <= KEPT_STEPS
        if (found := pool.pooled(RULES)) is not None:
            pooled.append(found.step)
    assert pooled[0] == 0
    assert pooled[-1] > ahead
    pool.add(searched("s0.1", 0, {NORTH: 1.0}))  # another worker begins it again
    for step in range(ahead, 3 * ahead):
        pool.add(searched("s0.1", step, {NORTH: 1.0}))
    pool.add(searched("s0.0", 3 * ahead, {NORTH: 1.0}))
    pool.add(searched("s0.1", 3 * ahead, {NORTH: 1.0}))
    assert pool.pooled(RULES).step == 3 * ahead


@pytest.mark.parametrize(("patient", "over"), [(True, [False, False, True]), (False, [True] * 3)])
def test_a_search_takes_longer_while_more_is_possible_than_can_be_tracked(
    patient: bool, over: list[bool]
) -> None:
    pool, settings = SearchPool(("s0.0",), 10), tracking(2, max_steps=3)
    ended = []
    for step in (12, 20, 21):
        pool.add(searched("s0.0", step, {NORTH: 0.4, SOUTH: 0.3, (9.0, 0.0, 0.0): 0.3}))
        ended.append(pool.finished(pool.pooled(RULES), settings, patient=patient))
    assert ended == over


TURN = np.array([0.0, 0.0, 2.0 * math.pi / 31.0])
AROUND = np.linspace(0.0, 2.0 * math.pi, 31, endpoint=False)
ENDS = [(3.0 * math.cos(angle), 3.0 * math.sin(angle)) for angle in (-0.2, 0.0, 0.2)]


def turned(made: Ensemble, first_step: int, turns: int) -> dict[int, float]:
    """After a robot at one of two places has turned on the spot: each scan favours c1."""
    for step in range(first_step, first_step + 31 * turns):
        turn = AROUND[step % 31]
        poses = [compose(np.array(place), np.array([0.0, 0.0, turn])) for place in (NORTH, SOUTH)]
        reports = [
            tracked("c0", step, 1.0, pose_tuple(poses[0]), fits=[0.95] * 3),
            tracked("c1", step, 1.0, pose_tuple(poses[1]), fits=[1.0] * 3),
            elsewhere(step, -40.0, ends=ENDS),
        ]
        outcome = made.advance(step, reports, TURN)
    return probabilities(outcome)


def two_places() -> Ensemble:
    return bootstrapped(
        {NORTH: 0.5, SOUTH: 0.5}, piece_evidence=0.7, kidnapping_probability=1e-9,
        search_every_steps=10_000,
    )  # fmt: skip


def test_a_piece_of_wall_counts_once_however_often_the_robot_turns() -> None:
    made = two_places()
    once = turned(made, 1, 1)
    assert 0.03 < once[0] < 0.3
    odds = turned(made, 32, 14)[0]
    assert math.log(odds) > 2.0 * math.log(once[0])


def test_beams_that_fit_behind_walls_speak_for_a_place_in_a_changed_building_only() -> None:
    behind = bytes([127 << 1 | 1] * 3)
    half = {}
    for share in (1 / 3, FRONT):
        made = two_places()
        made.clusters.learned = Learned(Familiarity.of(5 / 6), Familiarity.of(share))
        reports = [
            replace(tracked("c0", 1, 1.0, NORTH), fits=behind),
            tracked("c1", 1, 1.0, SOUTH, fits=[1.0] * 3),
            elsewhere(1, -40.0, ends=[(3.0, 0.0), (0.0, 3.0), (-3.0, 0.0)]),
        ]
        half[share] = probabilities(made.advance(1, reports, TURN))[0]
    assert half[1 / 3] == pytest.approx(0.5, abs=1e-6)
    assert half[FRONT] < 0.45


def test_seen_pieces_are_transferred_with_the_belief() -> None:
    made = two_places()
    turned(made, 1, 1)
    other = resumed(made)
    assert turned(other, 32, 1) == turned(made, 32, 1)
    other.pieces = Pieces()
    assert turned(other, 63, 1)[0] < 0.5 * turned(made, 63, 1)[0]


def test_odometry_that_drifts_shows_no_new_pieces_at_a_place_that_is_tracked() -> None:
    """The robot of `turned` stands in the map, and odometry says that it turns."""
    made, drifts = two_places(), two_places()
    for each, motion in ((made, np.zeros(3)), (drifts, TURN)):
        for step in range(1, 200):
            reports = [
                tracked("c0", step, 1.0, NORTH, fits=[0.95] * 3),
                tracked("c1", step, 1.0, SOUTH, fits=[1.0] * 3),
                elsewhere(step, -40.0, ends=ENDS),
            ]
            outcome = each.advance(step, reports, motion)
        assert 0.3 < probabilities(outcome)[0] < 0.5
    assert drifts.pieces == made.pieces


def test_where_no_place_reports_odometry_moves_the_pieces() -> None:
    made = two_places()
    made.advance(1, [], TURN)
    assert made.pieces.robot == pytest.approx(tuple(TURN))
