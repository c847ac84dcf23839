import math

import numpy as np
import pytest

from particle_filter.arrays import OCCUPIED
from particle_filter.cluster_filter import (
    ParticleSet,
    mcl_step,
    measurement_update,
    regularised_resample,
    resampled,
)
from particle_filter.likelihood_field_model import LikelihoodFieldModel
from particle_filter.poses import between
from particle_filter.sensor_model import Beams
from particle_filter.settings import ClusterSettings, MotionSettings, SensorSettings
from tests.unit.particle_filter.rooms import (
    model_of,
    plain_room,
    seen_from,
    symmetric_room,
)

HERE = np.array([1.0, 3.0, 0.3])


def cloud_round(pose: np.ndarray, count: int, sigma: float = 0.05, seed: int = 0) -> ParticleSet:
    rng = np.random.default_rng(seed)
    return ParticleSet.even(pose + rng.normal(0.0, sigma, (count, 3)))


def mean_occluded(cloud: ParticleSet, beams: Beams, model: LikelihoodFieldModel) -> float:
    return model.mean_occluded(cloud.map_from_robot, cloud.weights, beams)


def test_the_evidence_is_the_average_likelihood_of_the_particles() -> None:
    model, beams = model_of(plain_room()), seen_from(HERE, plain_room())
    cloud = cloud_round(HERE, 50)
    likelihood = np.exp(0.1 * model.log_likelihood(cloud.map_from_robot, beams))
    result = measurement_update(cloud, beams, model, exponent=0.1)
    assert result.log_weight_sum - math.log(50) == pytest.approx(math.log(likelihood.mean()))


def test_carried_weights_count_in_the_evidence() -> None:
    """Two scans without resampling are worth the average of both likelihoods' product."""
    model, beams = model_of(plain_room()), seen_from(HERE, plain_room())
    cloud = cloud_round(HERE, 50)
    first = measurement_update(cloud, beams, model, exponent=0.1)
    second = measurement_update(first.particles, beams, model, exponent=0.1)
    evidence = first.log_weight_sum + second.log_weight_sum - 2.0 * math.log(50)
    both = np.exp(0.2 * model.log_likelihood(cloud.map_from_robot, beams))
    assert evidence == pytest.approx(math.log(both.mean()))


def test_weights_sum_to_the_number_of_particles() -> None:
    model, beams = model_of(plain_room()), seen_from(HERE, plain_room())
    result = measurement_update(cloud_round(HERE, 64, sigma=0.5), beams, model, exponent=0.2)
    assert np.exp(result.particles.log_weights).sum() == pytest.approx(64.0)


def test_a_scan_without_a_valid_beam_adds_no_evidence() -> None:
    cloud = cloud_round(HERE, 10)
    nothing = Beams(np.empty(0), np.empty(0), np.zeros(3), 10.0)
    result = measurement_update(cloud, nothing, model_of(plain_room()), exponent=0.2)
    assert result.particles is cloud
    assert result.log_weight_sum == pytest.approx(math.log(10))


def test_particles_in_a_wall_pay() -> None:
    settings = SensorSettings(not_free_log_penalty=-3.0)
    model, beams = model_of(plain_room(), settings), seen_from(HERE, plain_room())
    in_wall, free = np.array([0.01, 3.0, 0.3]), np.array([0.06, 3.0, 0.3])
    both = ParticleSet.even(np.stack([in_wall, free]))
    result = measurement_update(both, beams, model, exponent=1e-9)
    lost = result.particles.log_weights[1] - result.particles.log_weights[0]
    assert lost == pytest.approx(3.0, abs=1e-6)


def test_few_particles_that_count_are_redrawn_and_many_are_not() -> None:
    rng = np.random.default_rng(0)
    settings = ClusterSettings(resample_below_ess=0.5)
    poses = cloud_round(HERE, 100).map_from_robot
    even = ParticleSet(poses, np.zeros(100))
    assert resampled(even, 100, settings, rng) is even
    one_counts = ParticleSet(poses, np.where(np.arange(100) == 7, 0.0, -50.0))
    redrawn = resampled(one_counts, 100, settings, rng)
    np.testing.assert_array_equal(redrawn.map_from_robot, np.tile(poses[7], (100, 1)))
    np.testing.assert_array_equal(redrawn.log_weights, np.zeros(100))


def test_a_step_follows_the_robot() -> None:
    model = model_of(plain_room())
    after = HERE + np.array([0.2, 0.05, 0.1])
    result = mcl_step(
        cloud_round(HERE, 500), between(HERE, after), seen_from(after, plain_room()), model,
        MotionSettings(), ClusterSettings(), np.random.default_rng(1),
    )  # fmt: skip
    mean, covariance = result.particles.gaussian()
    np.testing.assert_allclose(mean, after, atol=0.05)
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


def test_symmetric_places_have_the_same_evidence() -> None:
    """Half a turn of the world turns the cloud and leaves every likelihood as it is."""
    room = symmetric_room()
    model, beams = model_of(room), seen_from(HERE, room)
    cloud = cloud_round(HERE, 300, sigma=0.1)
    turned = cloud.map_from_robot * [-1.0, -1.0, 1.0] + [6.0, 4.0, np.pi]
    one = measurement_update(cloud, beams, model, exponent=0.1)
    other = measurement_update(ParticleSet.even(turned), beams, model, exponent=0.1)
    # Points within float32 rounding of a cell's border may fall to either side: 1e-7 of them.
    assert one.log_weight_sum == pytest.approx(other.log_weight_sum, abs=1e-3)


def test_a_cluster_draws_its_particles_from_the_sample_it_is_handed() -> None:
    rng = np.random.default_rng(0)
    sample = cloud_round(HERE, 200, sigma=0.1).map_from_robot
    cloud = regularised_resample(sample, np.zeros(200), 5_000, rng)
    assert len(cloud.map_from_robot) == 5_000
    mean, covariance = cloud.gaussian()
    np.testing.assert_allclose(mean, sample.mean(axis=0), atol=0.02)
    # The kernel adds a quarter of Silverman's width squared: under 10 % for 200 points.
    np.testing.assert_allclose(np.diag(covariance), sample.var(axis=0), rtol=0.15)


def test_an_exactly_known_pose_stays_exactly_known() -> None:
    sample = np.tile(HERE, (10, 1))
    cloud = regularised_resample(sample, np.zeros(10), 2_000, np.random.default_rng(0))
    np.testing.assert_allclose(cloud.map_from_robot, np.tile(HERE, (2000, 1)))


def test_beams_through_a_wall_count_against_a_cluster_only_where_there_is_a_wall() -> None:
    """The laser saw one large room; in a map with a wall across, half the beams cross it."""
    open_room, divided = plain_room(), plain_room()
    divided[:, 60] = OCCUPIED
    beams, cloud = seen_from(HERE, open_room), cloud_round(HERE, 50, sigma=0.01)
    assert mean_occluded(cloud, beams, model_of(open_room)) == pytest.approx(0.0, abs=0.1)
    assert mean_occluded(cloud, beams, model_of(divided)) > 10.0


def test_particles_at_one_place_share_the_beams_among_them() -> None:
    """Three lasers with a third of the beams each give the evidence of one with all beams."""
    divided = plain_room()
    divided[:, 60] = OCCUPIED
    beams = seen_from(HERE, plain_room())
    alone = model_of(divided, SensorSettings(visibility_beam_stride=1))
    sharing = model_of(divided, SensorSettings(visibility_beam_stride=3))
    whole = alone.occluded(HERE[None], beams)[0]
    parts = sharing.occluded(np.tile(HERE, (3, 1)), beams)
    assert whole > 10.0
    assert parts.mean() == pytest.approx(whole)
    assert len(set(parts)) > 1, "not everybody followed the same ones"


def test_a_ray_along_a_wall_is_not_hidden_by_a_heading_a_little_off() -> None:
    corridor = np.zeros((30, 400), np.int8)
    corridor[[0, -1], :] = corridor[:, [0, -1]] = OCCUPIED
    truth = np.array([1.0, 0.6, 0.0])
    beams = seen_from(truth, corridor)
    off = ParticleSet.even(np.tile(truth + np.array([0.0, 0.0, 0.02]), (20, 1)))
    assert mean_occluded(off, beams, model_of(corridor)) == pytest.approx(0.0, abs=0.1)


def test_no_ray_is_followed_where_it_is_turned_off() -> None:
    divided = plain_room()
    divided[:, 60] = OCCUPIED
    beams, cloud = seen_from(HERE, plain_room()), cloud_round(HERE, 50, sigma=0.01)
    off = model_of(divided, SensorSettings(visibility_particles=0))
    assert mean_occluded(cloud, beams, off) == 0.0
