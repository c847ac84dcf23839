import numpy as np
import pytest

from particle_filter.cluster_filter import ParticleSet
from particle_filter.places import places_of
from particle_filter.settings import SearchSettings


def test_a_place_has_its_share_of_the_weight_and_a_weighted_sample() -> None:
    here, there = np.array([1.0, 1.0, 0.0]), np.array([4.0, 1.0, 0.0])
    poses = np.concatenate([np.tile(here, (10, 1)), np.tile(there, (30, 1))])
    poses[5:10, 1] += 0.2  # half of those here are a little to the side, and count three times
    weights = np.concatenate([np.full(5, 3.0), np.full(5, 9.0), np.full(30, 2.0)])
    rules = SearchSettings(hand_over_particles=400)
    rng = np.random.default_rng(0)
    first, second = places_of(ParticleSet(poses, np.log(weights)), rules, 0.01, rng)
    assert (first.share, second.share) == pytest.approx((0.5, 0.5))
    aside = first if first.mean[0] < 2.0 else second
    assert aside.mean == pytest.approx([1.0, 1.15, 0.0])
    assert aside.covariance[1, 1] == pytest.approx(0.75 * 0.25 * 0.04)
    assert np.mean(aside.sample[:, 1] > 1.1) == pytest.approx(0.75, abs=0.003)
    assert len(aside.sample) == 400
    few = places_of(ParticleSet(poses, np.log(weights)), rules, 0.51, rng)
    assert few == [], "none has so much"


def test_less_probable_places_have_one_particle_each() -> None:
    """Places are ordered by their share, not by their discovery."""
    at_x = np.array([0.0, 5.0, 10.0, 15.0])
    poses = np.repeat(at_x, 50)[:, None] * [1.0, 0.0, 0.0]
    weights = np.repeat([2.0, 1.0, 4.0, 3.0], 50)
    rules = SearchSettings(hand_over_particles=20, places_with_particles=2)
    found = places_of(ParticleSet(poses, np.log(weights)), rules, 0.0, np.random.default_rng(0))
    assert [place.mean[0] for place in found] == [10.0, 15.0, 0.0, 5.0]
    assert [len(place.sample) for place in found] == [20, 20, 1, 1]
    for place in found:
        assert (place.sample == place.mean).all()
