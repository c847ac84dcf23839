from math import erf, hypot, pi, sqrt
from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.motion.model import _box_muller, move, move_with_noise, standard_normals
from clustermcl.filter.poses import between, compose, heading_distance, inverse
from clustermcl.filter.random_streams import Purpose, generator
from clustermcl.filter.settings import MotionSettings
from tests.unit.filter import naive

OMNI = MotionSettings(
    turn_noise_per_turn=0.2, turn_noise_per_metre=0.1, drive_noise_per_metre=0.15,
    drive_noise_per_turn=0.05, strafe_noise_per_metre=0.3,
)  # fmt: skip
DIFFERENTIAL = MotionSettings(
    model="differential", turn_noise_per_turn=0.2, turn_noise_per_metre=0.1,
    drive_noise_per_metre=0.15, drive_noise_per_turn=0.05,
)  # fmt: skip
both = pytest.mark.parametrize("settings", [OMNI, DIFFERENTIAL], ids=lambda s: s.model)

coordinate = st.floats(-50, 50).map(lambda metres: round(metres, 6))
pose = st.tuples(coordinate, coordinate, st.floats(-10, 10)).map(np.array)
step = st.tuples(*[st.floats(-2, 2).map(lambda value: round(value, 6))] * 3).map(np.array)
SINGLE = 5e-6
"""Directions of up to 16 rad are rounded to 5e-7 rad, and drives with noise are up to 8 m long."""
clouds = arrays(np.float64, (4, 3), elements=st.floats(-10, 10))
noises = arrays(np.float64, (4, 3), elements=st.floats(-4, 4))


def moved_by(cloud: Poses, motion: Pose, settings: MotionSettings, normals: Poses) -> Poses:
    """Normals: (N, 3), whatever their type."""
    return move_with_noise(cloud, motion, settings, np.ascontiguousarray(normals.T, np.float32))


@both
@given(cloud=clouds, before=pose, step=step, normals=noises)
def test_the_kernel_agrees_with_the_naive_loop(
    settings: MotionSettings, cloud: Poses, before: Pose, step: Pose, normals: Poses
) -> None:
    after = before + step
    moved = moved_by(cloud, between(before, after), settings, normals)
    expected = naive.move(cloud, before, after, settings, normals)
    np.testing.assert_allclose(moved[:, :2], expected[:, :2], atol=SINGLE)
    np.testing.assert_allclose(heading_distance(moved[:, 2], expected[:, 2]), 0.0, atol=SINGLE)
    assert ((moved[:, 2] >= -pi) & (moved[:, 2] < pi)).all()


@both
@given(cloud=clouds, before=pose, step=step)
def test_without_noise_every_particle_moves_as_the_robot_did(
    settings: MotionSettings, cloud: Poses, before: Pose, step: Pose
) -> None:
    after = compose(before, step)
    moved = moved_by(cloud, between(before, after), settings, np.zeros_like(cloud))
    expected = compose(cloud, step)
    slip = 0.0 if settings.model == "omnidirectional" else 0.02  # short drives lose their bearing
    np.testing.assert_allclose(moved[:, :2], expected[:, :2], atol=SINGLE + slip)
    np.testing.assert_allclose(heading_distance(moved[:, 2], expected[:, 2]), 0.0, atol=SINGLE)


@pytest.mark.parametrize("turn", [0.0, 0.3])
@pytest.mark.parametrize("drive", [0.0, 0.5, -0.5])
def test_omnidirectional_noise_has_the_promised_deviations(drive: float, turn: float) -> None:
    """40,000 draws estimate a deviation to 0.35 %: 2 % is a false alarm in 10^7."""
    start = np.array([2.0, 3.0, 0.7])
    after = np.array([drive, 0.0, turn])
    rng = np.random.default_rng(3)
    moved = move(np.tile(start, (40_000, 1)), after, OMNI, rng)
    errors = compose(inverse(compose(start, np.array([drive, 0.0, 0.0]))), moved)
    promised = [
        hypot(0.15 * drive, 0.05 * turn),
        hypot(0.3 * drive, 0.05 * turn),
        hypot(0.2 * turn, 0.1 * drive),
    ]
    np.testing.assert_allclose(errors.std(axis=0), promised, rtol=0.02, atol=1e-12)
    means = errors.mean(axis=0) - [0.0, 0.0, turn]
    assert (np.abs(means) <= 5.5 * np.array(promised) / 200 + 1e-12).all()  # 4e-8 each


@pytest.mark.parametrize("model", ["omnidirectional", "differential"])
def test_a_motion_uses_three_normal_numbers_a_particle(
    model: Literal["omnidirectional", "differential"],
) -> None:
    """So that a step's random numbers stay the same whatever the robot did."""
    settings = MotionSettings(model=model)
    for after in (np.zeros(3), np.array([1.0, 2.0, 3.0])):
        rng, counting = np.random.default_rng(2), np.random.default_rng(2)
        move(np.zeros((6, 3)), after, settings, rng)
        standard_normals(counting, 3, 6)
        assert rng.random() == counting.random()


# --- normal numbers ------------------------------------------------------------------------------


def drawn(rows: int, count: int) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    rng = generator(1, purpose=Purpose.TRACK, entity=0, step=0)
    return standard_normals(rng, rows, count)


def test_numbers_follow_the_normal_distribution() -> None:
    """Kolmogorov's distance of n draws is above 2.6 / sqrt(n) once in 400,000 times."""
    numbers = np.sort(drawn(3, 100_000).ravel()).astype(np.float64)
    n = len(numbers)
    expected = np.array([0.5 * (1.0 + erf(z / sqrt(2.0))) for z in numbers[::10]])
    distance = np.abs(expected - np.arange(n)[::10] / n).max()
    assert distance < 2.6 / sqrt(n) + 1 / n


def test_normal_numbers_have_tails_of_the_right_weight() -> None:
    """Beyond 3 deviations: 810 of 300,000 are expected, 28 their deviation, 5.5 of them at most."""
    assert abs(int((np.abs(drawn(3, 100_000)) > 3.0).sum()) - 810) < 155


@pytest.mark.parametrize("power", [1, 2])
def test_rows_of_normal_numbers_are_independent(power: int) -> None:
    """A row of 100,000 and its pair from the same words: correlations err by 0.003."""
    first, second, third, fourth = drawn(4, 100_000) ** power
    correlations = np.corrcoef([first, second, third, fourth])
    assert np.abs(np.asarray(correlations) - np.eye(4)).max() < 5.5 * 0.0032


@pytest.mark.parametrize(("rows", "count"), [(3, 0), (1, 1), (3, 5), (2, 4)])
def test_any_count_of_numbers_can_be_drawn(rows: int, count: int) -> None:
    numbers = drawn(rows, count)
    assert numbers.shape == (rows, count)
    assert numbers.dtype == np.float32
    assert np.isfinite(numbers).all()
    np.testing.assert_array_equal(numbers, drawn(rows, count))


def test_extreme_random_words_give_finite_numbers() -> None:
    normals = np.empty((2, 4), np.float32)
    _box_muller(np.array([0, 2**32 - 1, 2**64 - 2**32, 2**64 - 1], np.uint64), normals)
    assert np.isfinite(normals).all()
    assert np.abs(normals).max() == pytest.approx(sqrt(-2 * np.log(2.0**-33)), rel=1e-6)
