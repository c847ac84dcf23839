"""Kernels are compiled once: a second time takes a second, amid a robot's drive."""

import os
from collections.abc import Callable
from typing import Any, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from clustermcl.filter import log_weights
from clustermcl.filter.cluster import gaussian
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser import ray_casting
from clustermcl.filter.motion import model as motion
from clustermcl.filter.search import places
from clustermcl.filter.settings import MotionSettings
from tests.unit.filter.rooms import plain_room

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="nothing is compiled"
)
AFTER, EVEN = np.array([0.3, 0.1, 0.2]), np.ones(6)
OMNI, TWO_WHEELS = MotionSettings(), MotionSettings(model="differential")
JUMPS = ray_casting.jump_field(plain_room())
GRID = Grid(plain_room(), 0.1, np.zeros(3))


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


OF_POSES: list[tuple[Any, Callable[[NDArray[Any]], object]]] = [
    (gaussian._moments, lambda p: gaussian.fit_gaussian(p, EVEN)),
    (motion._drive_along_bearing, lambda p: motion.move(p, AFTER, OMNI, rng())),
    (motion._turn_drive_turn, lambda p: motion.move(p, AFTER, TWO_WHEELS, rng())),
    (ray_casting._cast_all, lambda p: ray_casting.cast_rays_from_poses(JUMPS, GRID, p, EVEN, 9.0)),
    (places._assign, lambda p: places.cluster_by_source_point(p, EVEN, 0.5, 0.3, 3)),
    (log_weights._weights_and_ess, lambda p: log_weights.weights_and_ess(p[:, 0])),
    (log_weights._multiplied, lambda p: log_weights.multiplied(p[:, 0], p[:, 1], 0.5, p[:, 2])),
]


@pytest.mark.parametrize(("kernel", "call"), OF_POSES)
def test_arrays_of_any_layout_and_precision_use_one_compiled_kernel(
    kernel: Any, call: Callable[[NDArray[Any]], object]
) -> None:
    poses = np.random.default_rng(2).uniform(1.0, 3.0, (6, 3))
    expected = call(poses)
    fixed = poses.copy()
    fixed.flags.writeable = False
    for same in (fixed, np.asfortranarray(poses), poses.repeat(2, axis=0)[::2]):
        np.testing.assert_equal(call(same), expected)
    call(poses.astype(np.float32))
    assert len(kernel.compiled) == 1


def test_cells_of_any_memory_layout_use_one_compiled_kernel() -> None:
    cells = plain_room()
    for same in (np.asfortranarray(cells), cells.repeat(2, axis=0)[::2]):
        np.testing.assert_array_equal(ray_casting.jump_field(same), JUMPS)
    assert len(cast(Any, ray_casting._squares).compiled) == 1
