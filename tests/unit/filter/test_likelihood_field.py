import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.likelihood_field import LikelihoodField, scan_log_likelihood
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import SensorSettings
from tests.unit.filter import naive

SENSOR = SensorSettings(max_obstacle_distance_m=1.0)
CELL_M = 0.25
FAR = naive.log_likelihood_at(1.0, SENSOR)
ORIGIN = np.zeros(3)
SLACK = 1e-3
"""Single precision places hits to about 1e-5 of these maps' cells: at a border, either may be."""


def random_map(rng: np.random.Generator, rows: int = 12, cols: int = 17) -> Cells:
    kinds = [FREE, OCCUPIED, UNKNOWN]
    return rng.choice(kinds, (rows, cols), p=[0.8, 0.15, 0.05]).astype(np.int8)


def tolerance(beams: int, field: LikelihoodField) -> float:
    """Half a code for each beam, and the single precision of the field itself."""
    return beams * (0.5 * field.log_step + 2e-6)


def decoded(field: LikelihoodField) -> NDArray[np.float64]:
    """(rows, cols) log-likelihood of a hit in each cell of the map."""
    return np.asarray(field.log_floor + field.log_step * field.codes[1:-1, 1:-1])


@settings(max_examples=20)  # each compares every cell with every obstacle
@given(seed=st.integers(0, 2**32))
def test_the_field_is_the_sensor_model_at_the_nearest_obstacle(seed: int) -> None:
    cells = random_map(np.random.default_rng(seed))
    cells[3, 3] = OCCUPIED
    truth = naive.log_field(cells, CELL_M, SENSOR)
    built = LikelihoodField.build(Grid(cells, CELL_M, ORIGIN), SENSOR)
    np.testing.assert_allclose(decoded(built), truth, atol=tolerance(1, built))
    assert built.log_step < 1e-4
    assert built.log_floor == pytest.approx(FAR)


@settings(max_examples=20)  # the twin is slow
@given(seed=st.integers(0, 2**32), turn=st.floats(-4, 4))
def test_the_kernel_agrees_with_the_naive_sum(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    cells = random_map(rng)
    cells[5, 5] = OCCUPIED
    map_from_grid = np.array([*rng.uniform(-5, 5, 2), turn])
    in_grid = rng.uniform([-2.0, -2.0, -7.0], [6.0, 5.0, 7.0], (20, 3))
    poses, hits = compose(map_from_grid, in_grid), rng.uniform(-3, 3, (11, 2))
    field = LikelihoodField.build(Grid(cells, CELL_M, map_from_grid), SENSOR)
    truth = naive.log_field(cells, CELL_M, SENSOR)
    sums = [naive.scan_log_likelihood(pose, hits, truth, FAR, field.grid) for pose in poses]
    expected, from_border = np.array(sums).T
    sure = from_border > SLACK
    assert sure.mean() > 0.5
    found = scan_log_likelihood(poses, hits, field)
    np.testing.assert_allclose(found[sure], expected[sure], atol=tolerance(len(hits), field))


@pytest.mark.parametrize(
    "outside",
    [
        *((-0.01, 0.5, 0.0), (0.5, -0.01, 0.0), (2.01, 0.5, 0.0), (0.5, 2.01, 0.0)),
        *((-1e9, 1e9, 0.0), (1e300, 0.5, 0.0)),
        *((np.nan, 0.5, 0.0), (0.5, np.inf, 0.0), (0.5, 0.5, np.nan)),
    ],
)
def test_a_hit_outside_the_map_or_nowhere_is_far_from_everything(
    outside: tuple[float, float, float],
) -> None:
    """All cells are obstacles, and yet one step outside there is nothing."""
    field = LikelihoodField.build(Grid(np.full((2, 2), OCCUPIED, np.int8), 1.0, ORIGIN), SENSOR)
    with np.errstate(over="ignore"):  # 1e300 is infinite in single precision
        found = scan_log_likelihood(np.array([outside]), np.zeros((1, 2)), field)
    assert found[0] == pytest.approx(FAR, abs=1e-6)


def test_a_scan_without_returns_is_refused() -> None:
    field = LikelihoodField.build(Grid(np.eye(4, dtype=np.int8), CELL_M, ORIGIN), SENSOR)
    with pytest.raises(ValueError, match="0 returns"):
        scan_log_likelihood(np.zeros((1, 3)), np.zeros((0, 2)), field)


def test_a_likelihood_field_with_little_contrast_keeps_its_values() -> None:
    flat = SensorSettings(max_obstacle_distance_m=1e-9)
    field = LikelihoodField.build(Grid(np.eye(4, dtype=np.int8), 1.0, ORIGIN), flat)
    found = scan_log_likelihood(np.ones((1, 3)), np.zeros((2, 2)), field)
    assert found[0] == pytest.approx(2 * naive.log_likelihood_at(0.0, flat))


def test_a_field_made_in_strips_is_that_of_the_whole_map() -> None:
    cells = np.zeros((1_100, 40), np.int8)
    cells[np.random.default_rng(5).random(cells.shape) < 0.001] = OCCUPIED
    cells[300:900] = 0  # strips without an obstacle of their own
    sensor = SensorSettings(max_obstacle_distance_m=3.0)
    distance_m = 0.1 * distance_transform_edt(cells != OCCUPIED)
    expected = [[naive.log_likelihood_at(d, sensor) for d in row] for row in distance_m[::7]]
    built = LikelihoodField.build(Grid(cells, 0.1, ORIGIN), sensor)
    np.testing.assert_allclose(decoded(built)[::7], expected, atol=tolerance(1, built) + 1e-5)
