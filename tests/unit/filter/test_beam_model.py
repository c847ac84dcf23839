import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from clustermcl.filter.arrays import LogWeights, Poses
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.beam_model import BeamModel, beam_density
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import SensorSettings
from tests.unit.filter import naive_rays
from tests.unit.filter.rooms import NO_OFFSET, scan_of

SETTINGS = SensorSettings(hit_weight=0.6, short_weight=0.2, max_weight=0.1, random_weight=0.4)
"""Weights count by their shares: they need not sum to one."""
CELL_M = 0.5
MAX_RANGE_M = 6.0
LASER = np.array([0.3, -0.1, 0.4])
ANGLES = np.linspace(-1.5, 1.5, 7)
HALL = (np.random.default_rng(5).random((14, 20)) < 0.08).astype(np.int8)
relaxed = settings(deadline=None, max_examples=30)  # the first call compiles
seeds = st.integers(0, 2**32 - 1)


def random_poses(seed: int) -> Poses:
    rng = np.random.default_rng(seed)
    return rng.uniform([-1.0, -1.0, -np.pi], [11.0, 8.0, np.pi], (6, 3))


def weigh(
    poses: Poses,
    ranges: NDArray[np.float64],
    settings: SensorSettings = SETTINGS,
) -> LogWeights:
    grid = Grid(HALL, CELL_M, NO_OFFSET)
    model = BeamModel.from_arrays(grid, BeamModel.arrays_of(grid, settings), settings)
    return model.log_likelihood(poses, model.beams(scan_of(ranges, MAX_RANGE_M, ANGLES, LASER)))


@relaxed
@given(seed=seeds)
def test_the_kernel_agrees_with_the_book_line_by_line(seed: int) -> None:
    poses, rng = random_poses(seed), np.random.default_rng(seed)
    readings = rng.uniform(0.1, MAX_RANGE_M, len(ANGLES))
    # Some did not return, each kind of them.
    readings[rng.integers(len(ANGLES), size=3)] = rng.choice([np.inf, 6.0, 81.9], 3)
    naive = [
        naive_rays.beam_log_likelihood(
            compose(pose, LASER), readings, ANGLES, HALL, CELL_M, MAX_RANGE_M, SETTINGS
        )
        for pose in poses
    ]
    # A Gaussian's tail past six deviations is left out: 1e-9 of each density.
    np.testing.assert_allclose(weigh(poses, readings), naive, atol=1e-6)


@pytest.mark.parametrize("expected", [0.05, 0.4, 3.0, 11.8, 12.0])
def test_the_density_of_all_readings_sums_to_one(expected: float) -> None:
    """Without return is a point mass; all the rest is a density over the range."""
    mixture = (0.7, 0.1, 0.05, 0.15, SETTINGS.hit_sigma_m, SETTINGS.short_decay_per_m, 12.0)
    middles = (np.arange(120_000) + 0.5) / 10_000
    densities = [beam_density(float(middle), expected, mixture) for middle in middles]
    assert np.mean(densities) * 12.0 + 0.05 == pytest.approx(1.0, abs=1e-3)  # steps of 0.1 mm


def test_no_reading_is_impossible() -> None:
    without_max = SensorSettings(max_weight=0.0, short_weight=0.0)
    assert np.isfinite(
        weigh(random_poses(2), np.full(len(ANGLES), np.inf), settings=without_max)
    ).all()


def test_a_scan_without_beams_is_refused() -> None:
    with pytest.raises(ValueError, match="one beam"):
        weigh(np.zeros((1, 3)), np.full(len(ANGLES), np.nan))
