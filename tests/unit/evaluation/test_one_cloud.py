"""The cloud of ordinary MCL: its start, and how it shrinks."""

import numpy as np
import pytest

from evaluation.one_cloud import OneCloud, start_particles, uniform_over_free_space
from particle_filter.arrays import UNKNOWN
from particle_filter.poses import between
from particle_filter.sensor_model import Grid
from particle_filter.settings import FilterSettings
from tests.unit.particle_filter.rooms import CELL_M, NO_OFFSET, model_of, plain_room, seen_from

HERE = np.array([1.0, 3.0, 0.3])


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


def test_a_large_map_gets_more_particles_within_bounds() -> None:
    sides = [(10, 10), (500, 500), (10_000, 10_000)]
    grids = [Grid(np.zeros(side, np.int8), 0.05, NO_OFFSET) for side in sides]
    assert [start_particles(grid) for grid in grids] == [50_000, 250_000, 2_000_000]


def test_a_map_without_a_free_cell_is_refused() -> None:
    grid = Grid(np.full((3, 3), UNKNOWN, np.int8), 0.1, NO_OFFSET)
    with pytest.raises(ValueError, match="no free cell"):
        uniform_over_free_space(grid, 10, np.random.default_rng(0))


def test_particles_shrink_evenly_in_the_logarithm_to_what_is_kept() -> None:
    """From 6,400 to 100, a half every step; the first scan is weighed by all."""
    cells, rng, counts = plain_room(), np.random.default_rng(0), []
    cloud = OneCloud(model_of(cells), FilterSettings(), np.tile(HERE, (6_400, 1)), kept=100)
    for step in range(8):
        cloud.advance(HERE if step else None, HERE, seen_from(HERE, cells), rng)
        counts.append(len(cloud.particles.log_weights))
        assert cloud.shrunk == (step >= 5)
    assert counts == [6_400, 3_200, 1_600, 800, 400, 200, 100, 100]


def test_few_that_count_are_redrawn() -> None:
    cells, rng = plain_room(), np.random.default_rng(0)
    poses = np.tile(HERE, (100, 1))
    poses[10:] = [3.0, 1.0, 2.0]  # fit far worse
    cloud = OneCloud(model_of(cells), FilterSettings(), poses, kept=100)
    cloud.advance(None, HERE, seen_from(HERE, cells), rng)
    cloud.advance(HERE, HERE, seen_from(HERE, cells), rng)
    assert np.mean(np.abs(cloud.particles.map_from_robot[:, 0] - 1.0) < 0.2) > 0.9
