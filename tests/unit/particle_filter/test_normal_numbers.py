from math import erf, sqrt

import numpy as np
import pytest

from particle_filter.motion import _box_muller, standard_normals
from particle_filter.random_streams import Purpose, generator


def drawn(
    rows: int, count: int, step: int = 0
) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    rng = generator(1, purpose=Purpose.TRACK, entity=0, step=step)
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
