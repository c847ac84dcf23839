import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from particle_filter.arrays import Poses
from particle_filter.places import cluster_by_source_point
from tests.unit.particle_filter import naive


def modes(rng: np.random.Generator, count: int) -> Poses:
    """Points around some places, also across the seam of headings and below zero."""
    places = rng.uniform([-3.0, -3.0, -np.pi], [3.0, 3.0, np.pi], (6, 3))
    return places[rng.integers(0, 6, count)] + rng.normal(size=(count, 3)) * [0.4, 0.4, 0.3]


@given(
    seed=st.integers(0, 2**32),
    radius_m=st.floats(0.2, 3.0),
    heading_rad=st.floats(0.1, 4.0),
    max_clusters=st.integers(1, 60),
)
def test_the_hash_grid_agrees_with_the_naive_search(
    seed: int, radius_m: float, heading_rad: float, max_clusters: int
) -> None:
    rng = np.random.default_rng(seed)
    arguments = (modes(rng, 60), rng.normal(size=60), radius_m, heading_rad, max_clusters)
    labels, count = cluster_by_source_point(*arguments)
    expected_labels, expected_count = naive.cluster_by_source_point(*arguments)
    assert labels.tolist() == expected_labels
    assert count == expected_count


def test_points_stay_without_a_cluster_at_the_limit_of_clusters() -> None:
    poses = np.array([[0.0, 0, 0], [5, 0, 0], [9, 0, 0], [5.1, 0, 0]])
    labels, count = cluster_by_source_point(poses, np.zeros(4), 1.0, 0.5, 2)
    assert labels.tolist() == [0, 1, -1, 1]
    assert labels.dtype == np.int32
    assert count == 2


def test_no_particles_make_no_clusters() -> None:
    labels, count = cluster_by_source_point(np.zeros((0, 3)), np.zeros(0), 1.0, 0.5, 2)
    assert labels.shape == (0,)
    assert count == 0


@pytest.mark.parametrize("reach", [(0.0, 0.5, 9), (1.0, 0.0, 9), (1.0, 0.5, 0), (np.nan, 0.5, 9)])
def test_a_radius_of_zero_is_refused(reach: tuple[float, float, int]) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        cluster_by_source_point(np.zeros((1, 3)), np.zeros(1), *reach)


def test_particles_without_place_or_weight_are_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        cluster_by_source_point(np.full((1, 3), np.nan), np.zeros(1), 1.0, 0.5, 9)
    with pytest.raises(ValueError, match="finite"):
        cluster_by_source_point(np.zeros((1, 3)), np.array([np.nan]), 1.0, 0.5, 9)
