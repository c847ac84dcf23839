import math

import numpy as np
import pytest
from msgspec.structs import replace

from benchmarks.experiments.mcl import (
    SHRINKING_STEPS,
    OrdinaryMCL,
    Recovery,
    RecoveryGains,
    uniform_over_free_space,
)
from clustermcl.filter.arrays import UNKNOWN
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import computed_model
from clustermcl.filter.poses import between
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.arrays import ArrayBlob
from tests.unit.filter.rooms import CELL_M, plain_room
from tests.unit.oracle import tiny_world
from tests.unit.oracle.tiny_world import TRUTH, Drive

ROOM_MODEL = computed_model(
    Grid(tiny_world.plain_room(), tiny_world.CELL_M, np.zeros(3)), tiny_world.SENSOR
)


def test_the_start_is_even_over_free_cells_and_only_there() -> None:
    cells = plain_room()
    cells[:40] = UNKNOWN
    map_from_grid = np.array([5.0, -2.0, 0.7])
    rng = np.random.default_rng(0)
    poses = uniform_over_free_space(Grid(cells, CELL_M, map_from_grid), 20_000, rng)
    in_grid = between(map_from_grid, poses)
    cols, rows = (np.floor(in_grid[:, i] / CELL_M).astype(int) for i in (0, 1))
    assert np.all(cells[rows, cols] == 0)
    # Stratified over rows: every band of ten rows holds its share to within a stratum or two.
    for band in range(40, 80, 10):
        share = np.count_nonzero(cells[band : band + 10] == 0) / np.count_nonzero(cells == 0)
        held = np.count_nonzero((rows >= band) & (rows < band + 10)) / len(rows)
        assert held == pytest.approx(share, abs=2e-4)
    eighths = np.histogram(poses[:, 2], bins=8, range=(-np.pi, np.pi))[0]
    assert np.all(np.abs(eighths - 2_500) < 50)


@pytest.mark.parametrize(("share", "is_redrawn"), [(0.49, True), (0.5, False), (0.51, False)])
def test_particles_are_resampled_below_half_the_effective_sample_size(
    share: float, is_redrawn: bool
) -> None:
    blind, settings = Drive(tiny_world.plain_room(), TRUTH, 1).scans[0], FilterSettings()
    blind = replace(blind, ranges=ArrayBlob.of(np.zeros(12), "float32"))  # weights stay
    followed = OrdinaryMCL(ROOM_MODEL, settings)
    followed.kept, followed.steps = 1_000, SHRINKING_STEPS  # the number shrinks no more
    with np.errstate(divide="ignore"):
        # Of n equal weights among zeros the effective sample size is n.
        log_weights = np.log((np.arange(1_000) < share * 1_000) / share)
    followed.particles = ParticleSet(np.tile(TRUTH, (1_000, 1)), log_weights)
    followed.advance(blind)
    assert (followed.particles.log_weights == 0.0).all() == is_redrawn


GAINS = RecoveryGains(slow=0.1, fast=0.5)


@pytest.mark.parametrize(
    ("likelihoods", "share"),
    [
        ((), 0.0),
        ((0.3,), 0.0),
        ((0.3,) * 20, 0.0),
        ((0.1, 0.2, 0.4, 0.8), 0.0),
        ((1.0, 0.2), 1.0 - 0.6 / 0.92),
        ((1.0, 0.2, 0.2), 1.0 - 0.4 / 0.848),
        ((math.exp(-1.0), 0.0, 0.0), 1.0 - 0.25 / 0.81),
    ],
)
def test_the_random_share_follows_from_the_fast_and_the_slow_average(
    likelihoods: tuple[float, ...], share: float
) -> None:
    recovery = Recovery(GAINS)
    for likelihood in likelihoods:
        recovery.on_likelihood(math.log(likelihood) if likelihood else -math.inf)
    assert recovery.random_share == pytest.approx(share, abs=1e-12)
