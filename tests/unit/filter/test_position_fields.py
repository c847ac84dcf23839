"""Fields of the robot's position, against sums over all cells of the map."""

import math
from dataclasses import replace

import numpy as np
import pytest

from clustermcl.filter.grid import Grid
from clustermcl.filter.observations.field import Field
from clustermcl.filter.observations.kind import NO_LANDMARKS as LANDMARKS
from clustermcl.filter.observations.likelihood import allowed_poses, log_likelihood_ratio
from clustermcl.filter.poses import compose
from tests.unit.oracle.grid_filter import Array

FALSE = 0.1
CRISP = 1e-20 * np.eye(2)
LEVELS = np.array([[0.0, 1.0, -2.0], [2.5, -1.0, 0.5]])


def a_map() -> Grid:
    """A tilted map with free, occupied and unknown parts."""
    cells = np.random.default_rng(8).choice([0, 0, 1, -1], (60, 80)).astype(np.int8)
    cells[20:50, 10:60] = 0
    return Grid(cells, 0.1, np.array([1.0, -2.0, 0.3]))


GRID = a_map()
ALL_FREE = Grid(np.zeros((100, 120), np.int8), 0.1, np.array([-2.0, -4.0, 0.0]))
SEEN = Field(np.array([1.0, -1.0]), CRISP, FALSE, cell_m=2.0, log_likelihoods=LEVELS)
# Its 6 m x 4 m are a part of the map


def free_centres(grid: Grid) -> Array:
    rows, cols = np.nonzero(grid.cells == 0)
    along, across = (cols + 0.5) * grid.cell_m, (rows + 0.5) * grid.cell_m
    return compose(grid.map_from_grid, np.column_stack([along, across, np.zeros(len(rows))]))


def density(x: float, y: float) -> float:
    col, row = math.floor((x - 1.0) / 2.0), math.floor((y + 1.0) / 2.0)
    return math.exp(LEVELS[row, col]) if 0 <= row < 2 and 0 <= col < 3 else 0.0


AVERAGE = np.mean([density(x, y) for x, y, _ in free_centres(GRID)])


def exact_likelihoods(poses: Array) -> Array:
    """Likelihoods by the page of docs, one pose after the other."""
    return np.array([FALSE + (1.0 - FALSE) * density(x, y) / AVERAGE for x, y, _ in poses])


def everywhere(count: int, seed: int) -> Array:
    return np.random.default_rng(seed).uniform((-2, -3, -4), (11, 8, 4), (count, 3))


def ratios(poses: Array, seen: Field = SEEN, grid: Grid = GRID) -> Array:
    return np.exp(log_likelihood_ratio(poses, [seen], LANDMARKS, grid))


def test_the_likelihood_is_relative_to_its_average_over_the_free_space() -> None:
    poses = everywhere(500, 1)
    np.testing.assert_allclose(ratios(poses), exact_likelihoods(poses), rtol=1e-9)
    assert ratios(free_centres(GRID)).mean() == pytest.approx(1.0, rel=1e-9)
    assert SEEN.log_average_ratio(LANDMARKS, GRID) == 0.0
    half = ratios(poses, replace(SEEN, share=0.5))
    np.testing.assert_allclose(half, np.sqrt(exact_likelihoods(poses)), rtol=1e-9)


def test_an_error_of_the_position_blurs_the_field() -> None:
    """As the average of many fields, each displaced by one error, before they are mixed."""
    fine = {"cell_m": 0.125, "log_likelihoods": np.kron(LEVELS, np.ones((16, 16)))}
    total, poses = np.zeros(300), everywhere(300, 2)
    blurred = ratios(poses, replace(SEEN, covariance=0.49 * np.eye(2), **fine), ALL_FREE)
    for off in np.random.default_rng(3).normal(0.0, 0.7, (2000, 2)):
        total += exact_likelihoods(poses - np.append(off, 0.0)) - FALSE
    inside = ((poses[:, :2] >= [1.0, -1.0]) & (poses[:, :2] < [7.0, 3.0])).all(axis=1)
    (outside,) = set(blurred[~inside].tolist())
    scale = np.median((blurred - outside)[inside] / total[inside])
    np.testing.assert_allclose(blurred[inside] - outside, scale * total[inside], rtol=0.2)
    assert FALSE + 0.1 < outside < FALSE + 0.3, "weight that leaves the field is an outlier's"
    far = ratios(poses, replace(SEEN, covariance=1e6 * np.eye(2)))
    np.testing.assert_allclose(far, 1.0, atol=0.01)
    motion = np.array([0.3, -0.4, 1.0])
    np.testing.assert_allclose(SEEN.moved(motion).covariance, CRISP + 0.25 * np.eye(2))
    np.testing.assert_array_equal(SEEN.moved(motion).mean, SEEN.mean)


@pytest.mark.parametrize(
    "seen",
    [
        replace(SEEN, mean=np.array([500.0, 500.0])),
        replace(SEEN, cell_m=1000.0, log_likelihoods=np.zeros((1, 1)), mean=np.array([-500.0] * 2)),
        replace(SEEN, log_likelihoods=np.array([[-3e38, 3e38]], np.float32),
                mean=np.array([-502.0, 0.0])),
    ],
)  # fmt: skip
def test_a_field_of_another_area_or_without_differences_is_no_evidence(seen: Field) -> None:
    np.testing.assert_allclose(ratios(free_centres(GRID), seen), 1.0)


def test_a_field_that_is_mostly_outside_the_free_space_is_mostly_an_outlier() -> None:
    """A robot outside the building is not at the part of it that is nearest."""
    off = replace(SEEN, mean=np.array([-40.0, -1.0]), log_likelihoods=np.zeros((1, 21)))
    assert (ratios(free_centres(GRID), off) >= 0.8).all()


def test_the_outlier_probability_is_that_of_the_cell() -> None:
    false = {}
    for x, y in ((2.0, 2.0), (2.0, 0.0), (0.0, 0.0)):
        false[x, y] = SEEN.outlier_probability_at(np.array([x, y, 0.3]), LANDMARKS, GRID)
    average = np.exp(LEVELS).mean()
    expected = [FALSE / (FALSE + 0.9 * math.exp(level) / average) for level in (2.5, 0.0)]
    assert list(false.values()) == pytest.approx([*expected, 1.0])


def test_allowed_poses_and_even_poses_estimate_an_average_together() -> None:
    rng, free_m2 = np.random.default_rng(9), (GRID.cells == 0).sum() * 0.01

    def function(poses: Array) -> Array:
        return np.exp(np.cos(poses[:, 2] - 0.4) - 0.1 * np.hypot(poses[:, 0], poses[:, 1]))

    even = np.repeat(free_centres(GRID), 100, axis=0)
    even[:, 2] = rng.uniform(-math.pi, math.pi, len(even))
    likelihood = np.exp(LEVELS) / np.exp(LEVELS).sum()
    inside = exact_likelihoods(even) - FALSE
    share = inside / inside.max() * likelihood.max() / 4.0 * free_m2
    exact = np.mean(function(even) * share / (1.0 + share))
    poses, log_weights = allowed_poses([SEEN], LANDMARKS, GRID, 100_000, rng)
    found = np.sum(np.exp(log_weights) * function(poses)) / 100_000
    assert found == pytest.approx(exact, rel=0.03)
    elsewhere = replace(SEEN, mean=np.array([500.0, 500.0]))
    assert allowed_poses([elsewhere], LANDMARKS, GRID, 100, rng)[0].shape == (0, 3)


def test_poses_are_drawn_where_a_field_has_free_space() -> None:
    half = replace(SEEN, mean=np.array([-6.0, -4.0]), log_likelihoods=np.zeros((1, 3)))
    drawn = half.draw(LANDMARKS, ALL_FREE, 100, np.random.default_rng(5))
    assert len(drawn) == 100, "one of its cells is on the map"
    assert ((drawn[:, :2] >= [-2.0, -4.0]) & (drawn[:, :2] < [0.0, -2.0])).all()


def test_search_starts_at_the_smallest_of_several_fields() -> None:
    small = replace(SEEN, cell_m=0.25, log_likelihoods=np.zeros((2, 2)), mean=np.array([3.0, 1.0]))
    large = replace(SEEN, cell_m=0.6, log_likelihoods=np.zeros((1, 1)), mean=np.array([3.0, 2.0]))
    rng = np.random.default_rng(4)
    poses, _ = allowed_poses([SEEN, small, large], LANDMARKS, GRID, 100, rng)
    assert ((poses[:, :2] >= [3.0, 1.0]) & (poses[:, :2] <= [3.5, 1.5])).all()
