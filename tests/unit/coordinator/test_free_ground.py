import msgspec
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from clustermcl.belief.free_ground import MAX_LEAVES, REACH_SIGMAS, FreeGround
from clustermcl.belief.given_places import diagonal
from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells
from clustermcl.filter.poses import compose
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import covariance_tuple
from clustermcl.recordings.maps.grid_map import GridMap

SHARP = diagonal(0.02, 0.1)


def room() -> FreeGround:
    """4 m x 2 m in cells of 0.1 m: a wall 0.8 m thick, a room of 2 m, and unknown ground."""
    cells = np.full((20, 40), UNKNOWN, np.int8)
    cells[:, :8], cells[:, 8:28] = OCCUPIED, FREE
    return FreeGround.of(GridMap(cells, 0.1, (0.0, 0.0, 0.0)))


def test_a_pose_far_from_free_ground_is_refused_and_a_slightly_negative_variance_is_not() -> None:
    for x, y in ((500.0, 500.0), (0.4, 1.0)):  # off the map, and in the wall
        assert f"x {x:.2f} m, y {y:.2f} m" in str(room().problem_of((x, y, 0.0), SHARP))
    crooked = (1.0, 0.0, 0.0, 0.0, -1e-9, 0.0, 0.0, 0.0, 0.01)
    assert room().problem_of((0.0, 1.0, 0.0), crooked) is None


def test_a_large_map_needs_little_memory() -> None:
    cells = np.full((4_000, 4_000), OCCUPIED, np.int8)
    cells[3_999, 3_999] = FREE
    ground = FreeGround.of(GridMap(cells, 0.05, (0.0, 0.0, 0.0)))
    assert len(ground.bits) <= MAX_LEAVES // 8 + 1
    assert ground.problem_of((199.97, 199.97, 0.0), SHARP) is None
    assert ground.problem_of((100.0, 100.0, 0.0), SHARP) is not None


@given(
    cells=arrays(np.int8, st.tuples(st.integers(1, 7), st.integers(1, 7)),
                 elements=st.sampled_from([FREE, OCCUPIED, UNKNOWN])),
    origin=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    pose=st.tuples(*[st.floats(-6.0, 6.0)] * 3),
    root=arrays(np.float64, (3, 3), elements=st.floats(-1.0, 1.0)),
)  # fmt: skip
def test_free_ground_agrees_with_the_distances_of_all_free_leaves(
    cells: Cells, origin: PoseTuple, pose: PoseTuple, root: NDArray[np.float64]
) -> None:
    """The naive way: every leaf's middle in the map, and its Mahalanobis distance."""
    assume(np.any(cells == FREE))  # a map without free ground is refused
    covariance = root @ root.T
    ground = FreeGround.of(GridMap(cells, 0.5, origin))
    spread = np.linalg.inv(covariance[:2, :2] + np.eye(2) * 0.5**2 / 12)
    distances = [
        (off := compose(np.array(origin), np.array([(col + 0.5) * 0.5, (row + 0.5) * 0.5, 0.0]))[:2]
         - pose[:2]) @ spread @ off
        for row, col in np.argwhere(cells == FREE)
    ]  # fmt: skip
    nearest = min(distances, default=np.inf)
    assume(abs(nearest - REACH_SIGMAS**2) > 1e-6)
    problem = ground.problem_of(pose, covariance_tuple(covariance))
    assert (problem is None) == (nearest < REACH_SIGMAS**2)


def test_too_few_bits_for_a_map_are_refused() -> None:
    """A forged recording must not make it allocate gigabytes."""
    reported = msgspec.msgpack.decode(msgspec.msgpack.encode(room()))
    for sides in ({"rows": 10**6, "cols": 10**6}, {"rows": -1}, {"rows": 0}):
        with pytest.raises(msgspec.ValidationError, match="do not fill"):
            msgspec.convert(reported | sides, FreeGround)
