import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clustermcl.filter.arrays import OCCUPIED, Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.laser.pyramid import Level, Pyramid, sum_steps
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import SensorSettings

SETTINGS = SensorSettings()
CELL_M = 0.1
MAP_FROM_GRID = np.array([3.0, -2.0, 0.4])


def random_map(seed: int, rows: int, cols: int) -> Cells:
    rng = np.random.default_rng(seed)
    cells = np.where(rng.random((rows, cols)) < 0.03, OCCUPIED, 0).astype(np.int8)
    cells[0, 0] = OCCUPIED
    return cells


def pyramid_of(cells: Cells) -> tuple[LikelihoodField, Pyramid]:
    field = LikelihoodField.build(Grid(cells, CELL_M, MAP_FROM_GRID), SETTINGS)
    arrays = Pyramid.arrays_of(field)
    return field, Pyramid.from_arrays(arrays, field.grid, SETTINGS)


def all_tiles(level: Level) -> np.ndarray:
    rows, cols = level.shape[2] - 1, level.shape[3] - 1
    return np.array([(row, 0, cols) for row in range(rows)])


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    rows=st.integers(1, 40),
    cols=st.integers(1, 40),
    heading=st.floats(-np.pi, np.pi),
)
def test_a_tile_bounds_all_positions_in_it(seed: int, rows: int, cols: int, heading: float) -> None:
    cells, rng = random_map(seed, rows, cols), np.random.default_rng(seed)
    field, pyramid = pyramid_of(cells)
    hits = rng.uniform(-3.0, 3.0, (9, 2))
    turned = compose(np.array([0.0, 0.0, heading]), np.insert(hits, 2, 0.0, axis=1))
    offsets = np.floor(turned[:, 1::-1] / CELL_M).astype(np.int64)
    in_grid = rng.uniform(0.0, 1.0, (200, 2)) * [cols, rows]  # [cells]
    poses = np.insert(in_grid * CELL_M, 2, heading, axis=1)
    exact = scan_log_likelihood(compose(MAP_FROM_GRID, poses), hits, field)
    for level in pyramid.levels[:-1]:
        runs = all_tiles(level)
        sums = sum_steps(level, offsets, runs).reshape(len(runs), -1).astype(np.float64)
        tiles = (in_grid // len(level)).astype(np.int64)
        bounds = len(hits) * pyramid.log_floor + pyramid.log_step * sums[tiles[:, 1], tiles[:, 0]]
        assert np.all(bounds >= exact - 1e-3), len(level)  # codes are summed with rounded scales


@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 30), cols=st.integers(1, 30))
@settings(max_examples=30, deadline=None)
def test_a_leaf_has_the_value_at_its_middle_and_coarser_tiles_no_less(
    seed: int, rows: int, cols: int
) -> None:
    cells, rng = random_map(seed, rows, cols), np.random.default_rng(seed)
    field, pyramid = pyramid_of(cells)
    offsets = rng.integers(-25, 25, (5, 2))
    leaf = pyramid.levels[-1]
    sums = sum_steps(leaf, offsets, all_tiles(leaf)).reshape(len(all_tiles(leaf)), -1)
    expected = np.zeros(sums.shape)
    for row, col in np.ndindex(*sums.shape):
        for down, across in offsets:
            y, x = np.array((row, col)) * len(leaf) + len(leaf) // 2 + (down, across)
            if 0 <= y < rows and 0 <= x < cols:
                expected[row, col] += np.ceil(field.codes[y + 1, x + 1] / 257)
    np.testing.assert_array_equal(sums, expected)
    for coarse, fine in zip(pyramid.levels[:-1], pyramid.levels[1:], strict=True):
        above = sum_steps(coarse, offsets, all_tiles(coarse)).reshape(len(all_tiles(coarse)), -1)
        below = sum_steps(fine, offsets, all_tiles(fine)).reshape(len(all_tiles(fine)), -1)
        for row, col in np.ndindex(*below.shape):
            assert above[row // 2, col // 2] >= below[row, col]


def test_runs_are_scored_in_their_order_wherever_they_lie() -> None:
    _, pyramid = pyramid_of(random_map(1, 40, 60))
    level, offsets = pyramid.levels[1], np.array([[3, -7], [-20, 11], [1000, 0]])
    whole = sum_steps(level, offsets, all_tiles(level)).reshape(10, 15)
    runs = np.array([(7, 2, 5), (0, 0, 15), (7, 14, 1)])
    expected = np.concatenate([whole[7, 2:7], whole[0], whole[7, 14:]])
    np.testing.assert_array_equal(sum_steps(level, offsets, runs), expected)
