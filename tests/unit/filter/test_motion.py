from math import erf, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.motion.model import _box_muller, move, standard_normals
from clustermcl.filter.poses import between, heading_distance
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
    return move(cloud, motion, settings, np.ascontiguousarray(normals.T, np.float32))


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
