import math

import numpy as np
import pytest

from clustermcl.filter.arrays import Pose
from clustermcl.filter.cluster.cluster_filter import (
    ParticleSet,
    mcl_step,
    measurement_update,
    regularised_resample,
    resampled,
)
from clustermcl.filter.laser.evidence_model import share_by_fit
from clustermcl.filter.laser.sensor_model import Beams
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import ClusterSettings, SensorSettings
from tests.unit.filter.rooms import PERFECT_ODOMETRY, model_of, plain_room, seen_from

HERE, NO_WAY = np.array([1.0, 3.0, 0.3]), np.zeros(3)


def uneven(count: int) -> ParticleSet:
    rng = np.random.default_rng(3)
    poses = HERE + rng.normal(0.0, 0.05, (count, 3))
    weights = rng.exponential(size=count) ** 2
    return ParticleSet(poses, np.log(weights / weights.sum() * count))


@pytest.mark.parametrize("count", [100, 400, 1_600])
def test_resampled_particles_have_equal_weights_and_the_same_mean(count: int) -> None:
    """Each has had its weight already, in how often it was drawn."""
    cloud = uneven(400)
    redrawn = resampled(cloud, count, ClusterSettings(), np.random.default_rng(0))
    assert redrawn is not cloud
    np.testing.assert_array_equal(redrawn.log_weights, np.zeros(count))
    expected = cloud.weights @ cloud.map_from_robot
    # Even multinomial draws would move the mean by 0.05 / sqrt(count), or 400 of the cloud itself.
    atol = 3.0 * 0.05 / math.sqrt(min(count, 400))
    np.testing.assert_allclose(redrawn.map_from_robot.mean(axis=0), expected, atol=atol)


@pytest.mark.parametrize(
    ("motion", "share"),
    [
        (NO_WAY, 0.0),
        (np.array([0.2, 0.0, 0.0]), 1.0 - math.exp(-1.0)),
        (np.array([0.0, 0.0, -0.2]), 1.0 - math.exp(-0.5)),
    ],
)
def test_a_scan_changes_weights_by_its_share_but_is_full_evidence(
    motion: Pose, share: float
) -> None:
    cloud, model = uneven(400), model_of(plain_room())
    rules = ClusterSettings(resample_below_ess=0.01, view_distance_m=0.2, view_turn_rad=0.4)
    beams, rng = seen_from(compose(HERE, motion), plain_room()), np.random.default_rng(0)
    result = mcl_step(cloud, motion, beams, model, PERFECT_ODOMETRY, rules, rng)
    moved = ParticleSet(result.particles.map_from_robot, cloud.log_weights)
    fit = model.log_likelihood(moved.map_from_robot, beams).max()
    share *= share_by_fit(float(fit) / beams.count, model.settings)
    whole = measurement_update(moved, beams, model)
    assert result.log_weight_sum == pytest.approx(whole.log_weight_sum)
    reported, in_full = (
        c.log_weights - cloud.log_weights for c in (result.particles, whole.particles)
    )
    np.testing.assert_allclose(reported - reported[0], share * (in_full - in_full[0]), atol=1e-9)


def test_the_exponent_applies_to_the_scan_and_not_to_the_free_ground() -> None:
    sensor = SensorSettings(scan_likelihood_exponent=0.25, not_free_log_penalty=-2.0)
    model = model_of(plain_room(), sensor)
    poses = np.array([[1.0, 3.0, 0.3], [1.1, 3.0, 0.3], [0.01, 3.0, 0.3]])
    beams = seen_from(HERE, plain_room())
    fit = model.log_likelihood(poses, beams)
    expected = 0.25 * fit + [0.0, 0.0, -2.0]
    result = measurement_update(ParticleSet.even(poses), beams, model)
    assert result.log_weight_sum == pytest.approx(np.logaddexp.reduce(expected))
    np.testing.assert_allclose(np.diff(result.particles.log_weights), np.diff(expected))


def test_ground_that_is_not_free_counts_as_little_as_the_scan_that_is_not_new() -> None:
    """Where walls have moved, the robot drives through those of the map."""
    poses = np.array([[1.0, 3.0, 0.3], [0.01, 3.0, 0.3]])
    beams = seen_from(HERE, plain_room())
    with_penalty, without = (
        measurement_update(ParticleSet.even(poses), beams, model_of(plain_room(), sensor), 0.3)
        for sensor in (
            SensorSettings(not_free_log_penalty=-2.0),
            SensorSettings(not_free_log_penalty=0.0),
        )
    )
    fit = model_of(plain_room()).log_likelihood(poses, beams).max() / beams.count
    share = 0.3 * share_by_fit(float(fit), SensorSettings())
    odds = [np.diff(each.particles.log_weights)[0] for each in (with_penalty, without)]
    assert odds[0] - odds[1] == pytest.approx(-2.0 * share)


def test_the_most_probable_particle_is_one_where_the_others_are() -> None:
    """One that a robot half a metre away would fit is not."""
    astray = compose(HERE, np.array([0.5, 0.0, 0.0]))
    cloud = ParticleSet.even(np.vstack([cloud_round(HERE, 200).map_from_robot, astray]))
    beams, model = seen_from(astray, plain_room()), model_of(plain_room())
    assert np.argmax(model.log_likelihood(cloud.map_from_robot, beams)) == 200
    best = measurement_update(cloud, beams, model).best
    assert best is not None
    assert math.dist(best[:2], HERE[:2]) < 0.25


@pytest.mark.parametrize("apart_m", [0.0, 1e8])
def test_equal_particles_and_those_far_away_on_a_line_have_a_most_probable_one(
    apart_m: float,
) -> None:
    line = np.array([[0.0, 0.0, 0.0], [-apart_m, -apart_m, 0.0], [apart_m, apart_m, 0.0]])
    beams, model = seen_from(HERE, plain_room()), model_of(plain_room())
    best = measurement_update(ParticleSet.even(HERE + line), beams, model).best
    np.testing.assert_array_equal(best, HERE)


def test_the_noise_has_half_of_silvermans_width() -> None:
    sigma = np.array([0.3, 0.1, 0.2])
    sample = np.random.default_rng(1).normal(size=(500, 3)) * sigma
    sample = (sample - sample.mean(axis=0)) / sample.std(axis=0) * sigma
    rng = np.random.default_rng(0)
    drawn = regularised_resample(sample, np.zeros(500), 500, rng)
    added = np.sort(drawn.map_from_robot[:, 0])  # each point is drawn once, then spread
    assert len(np.unique(added)) == 500
    width = 0.5 * (4.0 / (5.0 * 500)) ** (1.0 / 7.0)
    noise = drawn.map_from_robot - sample
    # 500 normal numbers know their deviation to 3 %: five times that.
    np.testing.assert_allclose(noise.std(axis=0), width * sigma, rtol=0.16)


def test_the_threshold_is_a_share_of_the_particles() -> None:
    half = ParticleSet(
        np.tile(HERE, (100, 1)), np.where(np.arange(100) < 50, math.log(2.0), -800.0)
    )
    assert half.effective_sample_size == pytest.approx(50.0)
    rng = np.random.default_rng(0)
    assert resampled(half, 100, ClusterSettings(resample_below_ess=0.49), rng) is half
    assert resampled(half, 100, ClusterSettings(resample_below_ess=0.51), rng) is not half
    exactly = ParticleSet.even(half.map_from_robot)
    assert resampled(exactly, 100, ClusterSettings(resample_below_ess=1.0), rng) is exactly


def cloud_round(pose: np.ndarray, count: int) -> ParticleSet:
    return ParticleSet.even(pose + np.random.default_rng(0).normal(0.0, 0.05, (count, 3)))


def test_a_scan_without_a_valid_beam_adds_no_evidence() -> None:
    cloud = cloud_round(HERE, 10)
    nothing = Beams(np.empty(0), np.empty(0), np.zeros(3))
    result = measurement_update(cloud, nothing, model_of(plain_room()))
    assert result.particles is cloud
    assert result.log_weight_sum == pytest.approx(math.log(10))


def test_an_exactly_known_pose_stays_exactly_known() -> None:
    sample = np.tile(HERE, (10, 1))
    cloud = regularised_resample(sample, np.zeros(10), 2_000, np.random.default_rng(0))
    np.testing.assert_allclose(cloud.map_from_robot, np.tile(HERE, (2000, 1)))
