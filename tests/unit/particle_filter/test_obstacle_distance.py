"""Distances to the nearest obstacle: as scipy has them, to the last bit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from particle_filter.obstacle_distance import obstacle_distance


def test_the_nearest_may_lie_in_any_direction() -> None:
    blocked = np.zeros((5, 7), bool)
    blocked[1, 2] = blocked[4, 6] = True
    distance = obstacle_distance(blocked)
    assert distance[1, 2] == 0.0
    assert distance[1, 0] == 2.0
    assert distance[4, 3] == 3.0
    assert distance[3, 4] == np.float32(np.sqrt(5.0))


def test_without_an_obstacle_there_is_no_end() -> None:
    assert np.isposinf(obstacle_distance(np.zeros((3, 4), bool))).all()


@given(
    blocked=st.one_of(
        arrays(bool, array_shapes(min_dims=2, max_dims=2, max_side=12)),
        arrays(bool, (3, 40), elements=st.integers(0, 30).map(lambda number: number == 0)),
    ).filter(lambda grid: bool(grid.any()))
)
def test_they_are_those_of_scipy(blocked: NDArray[np.bool_]) -> None:
    expected = distance_transform_edt(~blocked).astype(np.float32)
    np.testing.assert_array_equal(obstacle_distance(blocked), expected)
