import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from particle_filter.arrays import Cells
from particle_filter.ray_casting import cast_fan, cast_ray, flat, jump_field

RAYS = 40


@settings(deadline=None, max_examples=50)  # the first call compiles
@given(
    cells=arrays(np.int8, (9, 13), elements=st.sampled_from([0, 0, 0, 0, 0, -1, -1, 1])),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_ray_alone_is_as_long_as_among_others_to_the_last_bit(cells: Cells, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform([-3.0, -3.0], [16.0, 12.0])  # in the map or outside
    rays = np.stack([*rng.normal(0.0, 6.0, (2, RAYS)), rng.uniform(0.1, 2.0, RAYS)])
    rays[0, 0] = rays[1, 1] = 0.0  # along a row, along a column
    jumps, lengths = jump_field(cells), np.empty(RAYS)
    cast_fan(jumps, x, y, rays, RAYS, lengths)
    alone = [cast_ray(flat(jumps), x, y, dx, dy, until) for dx, dy, until in rays.T]
    assert alone == lengths.tolist()


def test_minus_zero_is_no_direction() -> None:
    cells = np.ones((5, 7), np.int8)
    cells[1:-1, 1:-1] = 0
    jumps, lengths = jump_field(cells), np.empty(4)
    rays = np.array([[1.0, -1.0, -0.0, -0.0], [-0.0, -0.0, 1.0, -1.0], [9.0, 9.0, 9.0, 9.0]])
    cast_fan(jumps, 2.5, 2.5, rays, 4, lengths)
    assert lengths.tolist() == [3.5, 1.5, 1.5, 1.5]
    assert [cast_ray(flat(jumps), 2.5, 2.5, *ray) for ray in rays.T] == lengths.tolist()
