"""Kernels are compiled once: a second time takes a second, amid a robot's drive."""

import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from particle_filter.gaussian import fit_gaussian
from particle_filter.log_weights import multiplied, shares
from particle_filter.motion import move
from particle_filter.ray_casting import cast_rays_from_poses, jump_field
from particle_filter.settings import MotionSettings
from particle_filter.slip import slipped
from particle_filter.source_clustering import cluster_by_source_point
from tests.unit.particle_filter.rooms import plain_room

pytestmark = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="nothing is compiled"
)
MOTION, EVEN = np.array([0.3, 0.1, 0.2]), np.ones(6)
JUMPS = jump_field(plain_room())


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


OF_POSES: dict[str, Callable[[NDArray[Any]], object]] = {
    "the Gaussian": lambda poses: fit_gaussian(poses, EVEN),
    "motion": lambda poses: move(poses, MOTION, MotionSettings(), rng()),
    "motion on two wheels": lambda poses: move(
        poses, MOTION, MotionSettings(model="differential"), rng()
    ),
    "slipping": lambda poses: slipped(poses, poses, MOTION, rng()),
    "rays": lambda poses: cast_rays_from_poses(JUMPS, 0.05, poses, EVEN, 9.0),
    "clusters": lambda poses: cluster_by_source_point(poses, EVEN, 0.5, 0.3, 3),
    "shares": lambda poses: shares(poses[:, 0]),
    "products": lambda poses: multiplied(poses[:, 0], poses[:, 1], 0.5, poses[:, 2]),
}


def compiled() -> int:
    """How often kernels have been."""
    modules = [sys.modules[name] for name in sys.modules if name.startswith("particle_filter.")]
    kernels = {id(k): k for m in modules for k in vars(m).values() if hasattr(k, "signatures")}
    return sum(len(kernel.signatures) for kernel in kernels.values())


@pytest.mark.parametrize("name", OF_POSES)
def test_numbers_of_any_layout_and_precision_are_for_one_kernel(name: str) -> None:
    call, poses = OF_POSES[name], np.random.default_rng(2).uniform(1.0, 3.0, (6, 3))
    expected = call(poses)
    before = compiled()
    written_once = poses.copy()
    written_once.flags.writeable = False
    for same in (written_once, np.asfortranarray(poses), poses.repeat(2, axis=0)[::2]):
        np.testing.assert_equal(call(same), expected)
    call(poses.astype(np.float32))
    assert compiled() == before


def test_cells_of_any_layout_are_for_one_kernel() -> None:
    cells = plain_room()
    before = compiled()
    for same in (np.asfortranarray(cells), cells.repeat(2, axis=0)[::2]):
        np.testing.assert_array_equal(jump_field(same), JUMPS)
    assert compiled() == before
