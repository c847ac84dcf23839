import math
from itertools import product

import numpy as np
import pytest
from msgspec.structs import replace

from particle_filter.arrays import Pose, Poses
from particle_filter.cluster_filter import MeasurementUpdate, ParticleSet, mcl_step
from particle_filter.motion import move, slipped
from particle_filter.poses import compose
from particle_filter.sensor_models import computed_model
from particle_filter.settings import ClusterSettings, MotionSettings, SensorSettings
from tests.unit.particle_filter.rooms import model_of, plain_room, seen_from

BEFORE = np.array([3.0, 3.0, 0.3])
FORWARDS, BACKWARDS = np.array([0.4, 0.0, 0.0]), np.array([-0.4, 0.0, 0.0])
WITH = MotionSettings()
WITHOUT = replace(WITH, slip_probability=0.0)
EAGER = replace(WITH, slip_below_fit=10.0)
"""A slip is thought of at every step."""
MODEL = model_of(plain_room())


def particles() -> Poses:
    """(1000, 3) of the cloud before the drive."""
    return BEFORE + np.random.default_rng(5).normal(0.0, [0.03, 0.03, 0.02], (1000, 3))


def after_forwards() -> tuple[Poses, Poses]:
    """Where `after_a_drive` tries those particles: by odometry, and one in four as slipped."""
    rng = np.random.default_rng(6)
    moved = move(particles(), FORWARDS, WITH, rng)
    return moved, slipped(particles()[::4], moved[::4], FORWARDS, rng)


def after_a_drive(true_motion: Pose, settings: MotionSettings) -> MeasurementUpdate:
    """A step of a localized particle set; odometry reports a drive forwards."""
    beams = seen_from(compose(BEFORE, true_motion), plain_room())
    cloud, rng = ParticleSet.even(particles()), np.random.default_rng(6)
    return mcl_step(cloud, FORWARDS, beams, MODEL, settings, ClusterSettings(), rng)


def error_m(result: MeasurementUpdate, true_motion: Pose) -> float:
    mean, _ = result.particles.gaussian()
    return math.dist(mean[:2], compose(BEFORE, true_motion)[:2])


def test_a_robot_that_moved_otherwise_than_its_wheels_is_followed() -> None:
    assert error_m(after_a_drive(BACKWARDS, WITHOUT), BACKWARDS) > 0.6
    assert error_m(after_a_drive(BACKWARDS, WITH), BACKWARDS) < 0.25
    stood = np.zeros(3)
    assert error_m(after_a_drive(stood, WITH), stood) < 0.2


def test_slips_change_nothing_where_scans_fit() -> None:
    with_slip, without = after_a_drive(FORWARDS, WITH), after_a_drive(FORWARDS, WITHOUT)
    poses = [result.particles.map_from_robot for result in (with_slip, without)]
    np.testing.assert_array_equal(*poses)
    assert with_slip.log_weight_sum == without.log_weight_sum


def test_slips_keep_the_number_and_the_sum_of_weights() -> None:
    result = after_a_drive(BACKWARDS, WITH)
    assert result.particles.map_from_robot.shape == (1000, 3)
    assert np.exp(result.particles.log_weights).sum() == pytest.approx(1000.0)


def test_the_evidence_of_a_possible_slip_follows_bayes_rule() -> None:
    """(1 - p) times its likelihood where odometry says, p times that where slips lead.

    Particles that weigh more weigh more as slipped ones, too.
    """
    probability, beams = 0.4, seen_from(compose(BEFORE, BACKWARDS), plain_room())
    weights = np.exp((particles()[:, 2] - BEFORE[2]) / 0.02)
    weights /= weights.sum()
    # A small exponent: what odometry says fits badly, and still counts.
    sensor = SensorSettings(scan_likelihood_exponent=0.01, visibility_particles=0)
    result = mcl_step(
        ParticleSet(particles(), np.log(len(weights) * weights)), FORWARDS, beams,
        computed_model(MODEL.grid, sensor), replace(WITH, slip_probability=probability),
        ClusterSettings(resample_below_ess=0.1), np.random.default_rng(6),
    )  # fmt: skip
    moved, back = (np.exp(0.01 * MODEL.log_likelihood(at, beams)) for at in after_forwards())
    by_odometry = (1.0 - probability) * (weights @ moved)
    by_slip = probability * (weights[::4] @ back) / 0.25
    assert 0.1 < by_odometry / by_slip < 10.0, "both count"
    likelihood = result.log_weight_sum - math.log(len(weights))
    assert likelihood == pytest.approx(math.log(by_odometry + by_slip), abs=1e-9)


def test_slips_are_tried_only_where_scans_fit_badly() -> None:
    """However much better it fits: `slip_below_fit` defines a bad fit."""
    fits_badly = after_a_drive(BACKWARDS, WITHOUT).log_likelihood_per_beam
    for least, follows in ((fits_badly - 0.01, False), (fits_badly + 0.01, True)):
        result = after_a_drive(BACKWARDS, replace(WITH, slip_below_fit=least))
        assert (error_m(result, BACKWARDS) < 0.25) == follows


def test_a_slip_has_to_fit_better_by_the_slip_gain() -> None:
    gains, taken = [], []
    for x_m, turn in product(np.linspace(0.3, 0.2, 21), (-0.1, 0.1)):
        true_motion = np.array([x_m, 0.0, turn])
        eager, without = (after_a_drive(true_motion, s) for s in (EAGER, WITHOUT))
        beams = seen_from(compose(BEFORE, true_motion), plain_room())
        moved, back = (MODEL.log_likelihood(at, beams).max() for at in after_forwards())
        gains.append((back - moved) / beams.count)
        poses = [result.particles.map_from_robot for result in (eager, without)]
        taken.append(not np.array_equal(*poses))
    assert taken == [gain > 0.15 for gain in gains]
    assert {True, False} == {gain > 0.15 for gain in gains if 0.0 < gain < 0.3}, "near it, too"


def test_a_slipped_robot_is_behind_its_odometry() -> None:
    before = np.tile([1.0, 2.0, math.pi / 2], (2000, 1))
    after = compose(before, np.array([0.4, 0.0, 0.1]))
    back = slipped(before, after, np.array([0.4, 0.0, 0.1]), np.random.default_rng(1))
    np.testing.assert_allclose(back[:, 0], after[:, 0], atol=1e-12)  # it drove along y
    assert (back[:, 1].min(), back[:, 1].max()) == pytest.approx((2.0 - 0.6, 2.4), abs=0.01)
    # Five standard deviations of a mean of 2,000.
    assert back[:, 2].mean() == pytest.approx(math.pi / 2 + 0.1, abs=5 * 0.12 / math.sqrt(2000))
