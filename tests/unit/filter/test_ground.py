import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import ground_log_penalty
from tests.unit.filter import naive

CELLS = np.array([[FREE, OCCUPIED], [UNKNOWN, FREE], [FREE, FREE]], np.int8)
GRID = Grid(CELLS, 1.0, np.zeros(3))


def test_poses_that_are_not_finite_are_penalised() -> None:
    poses = np.array([[np.nan, 0.5, 0.0], [0.5, np.inf, 0.0], [1e300, -1e300, 0.0]])
    assert ground_log_penalty(poses, GRID, -2.0).tolist() == [-2.0] * 3


@given(seed=st.integers(0, 2**32), turn=st.floats(-4, 4))
def test_the_kernel_agrees_with_the_naive_loop(seed: int, turn: float) -> None:
    rng = np.random.default_rng(seed)
    cells = rng.integers(-1, 2, (7, 9)).astype(np.int8)
    cells.flags.writeable = False
    map_from_grid = np.array([*rng.uniform(-3, 3, 2), turn])
    poses = rng.uniform(-6, 6, (40, 3))
    np.testing.assert_array_equal(
        ground_log_penalty(poses, Grid(cells, 0.5, map_from_grid), -1.5),
        naive.ground_log_penalty(poses, cells, 0.5, map_from_grid, -1.5),
    )
