import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.filter.arrays import Poses
from clustermcl.filter.cluster.cluster_filter import ParticleSet
from clustermcl.filter.search.places import Parts, cluster_by_source_point, places_of
from clustermcl.filter.settings import BeliefSettings, FilterSettings, SearchSettings
from tests.unit.filter import naive


def settings(search: SearchSettings, **belief: float) -> FilterSettings:
    return FilterSettings(search=search, belief=replace(BeliefSettings(), **belief))


def test_a_place_has_its_share_of_the_weight_and_a_weighted_sample() -> None:
    here, there = np.array([1.0, 1.0, 0.0]), np.array([4.0, 1.0, 0.0])
    poses = np.concatenate([np.tile(here, (10, 1)), np.tile(there, (30, 1))])
    poses[5:10, 1] += 0.2  # half of those here are a little to the side, and count three times
    weights = np.concatenate([np.full(5, 3.0), np.full(5, 9.0), np.full(30, 2.0)])
    search = SearchSettings(hand_over_particles=400)
    rng = np.random.default_rng(0)
    first, second = places_of(ParticleSet(poses, np.log(weights)), settings(search), rng)
    assert (first.share, second.share) == pytest.approx((0.5, 0.5))
    aside = first if first.mean[0] < 2.0 else second
    assert aside.mean == pytest.approx([1.0, 1.15, 0.0])
    assert aside.covariance[1, 1] == pytest.approx(0.75 * 0.25 * 0.04)
    assert np.mean(aside.sample[:, 1] > 1.1) == pytest.approx(0.75, abs=0.003)
    assert len(aside.sample) == 400
    few = places_of(
        ParticleSet(poses, np.log(weights)), settings(search, least_probability=0.51), rng
    )
    assert few == [], "none has so much"


def test_a_place_without_poses_has_no_share() -> None:
    labels, weights = np.array([1, -1, 1], np.int32), np.array([0.5, 0.25, 0.25])
    parts = Parts.of(np.arange(9.0).reshape(3, 3), weights, labels, 3)
    assert (parts.shares.tolist(), parts.ends.tolist()) == ([0.0, 0.75, 0.0], [0, 0, 2, 2])
    assert parts.poses[:, 0].tolist() == [0.0, 6.0]


def test_less_probable_places_have_one_particle_each() -> None:
    """Places are ordered by their share, not by their discovery."""
    at_x = np.array([0.0, 5.0, 10.0, 15.0])
    poses = np.repeat(at_x, 50)[:, None] * [1.0, 0.0, 0.0]
    weights = np.repeat([2.0, 1.0, 4.0, 3.0], 50)
    rules = settings(SearchSettings(hand_over_particles=20), max_clusters=2)
    found = places_of(ParticleSet(poses, np.log(weights)), rules, np.random.default_rng(0))
    assert [place.mean[0] for place in found] == [10.0, 15.0, 0.0, 5.0]
    assert [len(place.sample) for place in found] == [20, 20, 1, 1]
    for place in found:
        assert (place.sample == place.mean).all()


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


@pytest.mark.parametrize("off", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, np.pi / 2)])
def test_a_pose_at_the_limit_of_the_reach_is_near(off: tuple[float, ...]) -> None:
    for times, expected in ((1.0, 1), (1.001, 2)):
        poses = np.array([np.zeros(3), times * np.array(off)])
        _, count = cluster_by_source_point(poses, np.zeros(2), 1.0, np.pi / 2, 9)
        assert count == expected


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
