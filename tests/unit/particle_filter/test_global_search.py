import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from particle_filter.arrays import UNKNOWN
from particle_filter.global_search import (
    GlobalSearch,
    start_particles,
    uniform_over_free_space,
)
from particle_filter.poses import between, heading_distance
from particle_filter.settings import FilterSettings, SearchSettings
from tests.unit.particle_filter.rooms import (
    CELL_M,
    NO_OFFSET,
    model_of,
    plain_room,
    seen_from,
    symmetric_room,
)

START = np.array([1.0, 3.2, -0.4])
SETTINGS = FilterSettings(
    search=SearchSettings(
        min_start_particles=30_000, max_start_particles=30_000, particles=6_000, shards=1
    )
)


def searched(cells: np.ndarray, steps: int, seed: int) -> GlobalSearch:
    """A search fed with perfect scans of a robot that drives a gentle curve."""
    rng = np.random.default_rng(seed)
    area_m2 = np.count_nonzero(cells == 0) * CELL_M**2
    count = start_particles(area_m2, SETTINGS.search)
    start = uniform_over_free_space(cells, CELL_M, NO_OFFSET, count, 0, 1, rng)
    search = GlobalSearch(model_of(cells), SETTINGS, start)
    before = None
    for step in range(steps):
        pose = pose_at(step)
        search.advance(before, pose, seen_from(pose, cells), rng)
        before = pose
    return search


def pose_at(step: int) -> np.ndarray:
    return START + step * np.array([0.15, -0.05, 0.05])


def is_near(pose: np.ndarray, truth: np.ndarray) -> bool:
    near = math.dist(pose[:2], truth[:2]) < 0.3
    return near and float(heading_distance(pose[2], truth[2])) < 0.2


def test_it_finds_the_one_place() -> None:
    search = searched(plain_room(), steps=10, seed=0)
    best = search.places(np.random.default_rng(0))[0]
    assert is_near(best.mean, pose_at(9))
    assert best.share > 0.9


def test_it_finds_both_of_two_places_that_look_alike_in_ten_of_ten_runs() -> None:
    turned = pose_at(9) * [-1.0, -1.0, 1.0] + [6.0, 4.0, np.pi]
    for seed in range(10):
        places = searched(symmetric_room(), steps=10, seed=seed).places(np.random.default_rng(0))
        shares = [
            sum(place.share for place in places if is_near(place.mean, truth))
            for truth in (pose_at(9), turned)
        ]
        assert min(shares) > 0.02, f"seed {seed}: {shares}"
        assert sum(shares) > 0.9, f"seed {seed}: {shares}"


def test_particles_shrink_while_the_exponent_rises() -> None:
    early, late = searched(plain_room(), 2, seed=0), searched(plain_room(), 8, seed=0)
    assert not early.annealed
    assert late.annealed
    assert len(early.cloud.log_weights) > len(late.cloud.log_weights) == 6_000


@given(st.integers(1, 7), st.integers(1, 300))
def test_the_shards_share_the_strata(shards: int, count: int) -> None:
    rng = np.random.default_rng(0)
    sizes = [
        len(uniform_over_free_space(plain_room(), CELL_M, NO_OFFSET, count, s, shards, rng))
        for s in range(shards)
    ]
    assert sum(sizes) == count
    assert max(sizes) - min(sizes) <= 1


def test_the_start_is_even_over_free_cells_and_only_there() -> None:
    cells = plain_room()
    cells[:40] = UNKNOWN
    map_from_grid = np.array([5.0, -2.0, 0.7])
    rng = np.random.default_rng(0)
    poses = uniform_over_free_space(cells, CELL_M, map_from_grid, 20_000, 0, 1, rng)
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
    rules = SearchSettings(
        start_particles_per_m2=100, min_start_particles=1_000, max_start_particles=50_000
    )
    assert [start_particles(area, rules) for area in (1.0, 200.0, 1e6)] == [1_000, 20_000, 50_000]


def test_a_map_without_a_free_cell_is_refused() -> None:
    cells = np.full((3, 3), UNKNOWN, np.int8)
    with pytest.raises(ValueError, match="no free cell"):
        uniform_over_free_space(cells, 0.1, NO_OFFSET, 10, 0, 1, np.random.default_rng(0))
