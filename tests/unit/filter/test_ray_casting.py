import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from clustermcl.filter.arrays import Cells
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.ray_casting import cast_ray, cast_rays_from_poses, flat, jump_field
from clustermcl.filter.poses import compose
from tests.unit.filter import naive_rays
from tests.unit.filter.naive_rays import cast_rays

CELL_M = 0.25
ALL_AROUND = np.linspace(-np.pi, np.pi, 48, endpoint=False) + 0.01  # never along a grid line
grids = arrays(np.int8, (9, 13), elements=st.sampled_from([0, 0, 0, 0, 0, -1, -1, 1]))
relaxed = settings(deadline=None, max_examples=50)  # the first call compiles
seeds = st.integers(0, 2**32 - 1)


def random_poses(seed: int) -> NDArray[np.float64]:
    """Poses in and around a grid of 9 x 13 cells; at random, none lies on a grid line."""
    rng = np.random.default_rng(seed)
    return rng.uniform([-1.0, -1.0, -np.pi], [13 * CELL_M + 1.0, 9 * CELL_M + 1.0, np.pi], (4, 3))


def box() -> Cells:
    """A closed room of 3 x 5 free cells."""
    cells = np.ones((5, 7), dtype=np.int8)
    cells[1:-1, 1:-1] = 0
    return cells


@relaxed
@given(cells=grids)
def test_jumps_are_the_largest_free_squares_ahead(cells: Cells) -> None:
    np.testing.assert_array_equal(jump_field(cells), naive_rays.jump_field(cells))


def test_a_jump_too_long_for_a_byte_becomes_several() -> None:
    cells = np.zeros((300, 600), dtype=np.int8)
    cells[290, 0] = 1
    assert jump_field(cells)[0, 289, 250:258].tolist() == [251, 252, 253, 254, 255, 255, 255, 255]
    laser = np.array([599.5, 290.5, np.pi])
    grid = Grid(cells, 1.0, np.zeros(3))
    assert cast_rays_from_poses(jump_field(cells), grid, laser[None], np.zeros(1), 1e3) == [[598.5]]


@relaxed
@given(cells=grids, seed=seeds)
def test_rays_with_jumps_are_as_long_as_naive_rays(cells: Cells, seed: int) -> None:
    poses = random_poses(seed)
    map_from_grid = np.array([1.5, -2.0, 0.4])
    grid, in_map = Grid(cells, CELL_M, map_from_grid), compose(map_from_grid, poses)
    jumped = cast_rays_from_poses(jump_field(cells), grid, in_map, ALL_AROUND, 3.0)
    naive = [
        [naive_rays.cast_ray(cells, CELL_M, pose, angle, 3.0) for angle in ALL_AROUND]
        for pose in poses
    ]
    np.testing.assert_allclose(jumped, naive, atol=1e-9)  # rounding of lengths under 10 m


@pytest.mark.parametrize("pose", [[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0]])
def test_a_pose_that_is_not_finite_is_refused(pose: list[float]) -> None:
    with pytest.raises(ValueError, match="finite"):
        cast_rays(box(), 1.0, np.array(pose), np.zeros(1), 5.0)


@pytest.mark.parametrize(("cell_m", "max_range_m"), [(0.0, 5.0), (0.1, -1.0), (np.nan, 5.0)])
def test_lengths_that_are_not_positive_are_refused(cell_m: float, max_range_m: float) -> None:
    with pytest.raises(ValueError, match="positive"):
        cast_rays(box(), cell_m, np.zeros(3), np.zeros(1), max_range_m)


def test_a_ray_direction_of_minus_zero_is_parallel_to_an_axis() -> None:
    cells = np.ones((5, 7), np.int8)
    cells[1:-1, 1:-1] = 0
    rays = ((1.0, -0.0), (-1.0, -0.0), (-0.0, 1.0), (-0.0, -1.0))
    lengths = [cast_ray(flat(jump_field(cells)), 2.5, 2.5, dx, dy, 9.0) for dx, dy in rays]
    assert lengths == [3.5, 1.5, 1.5, 1.5]
