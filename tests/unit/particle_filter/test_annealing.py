"""The global search step by step: exponent, jitter, number of particles and evidence."""

import math

import numpy as np
import pytest

from particle_filter.cluster_filter import Cloud, weighed
from particle_filter.global_search import GlobalSearch, places_of
from particle_filter.settings import FilterSettings, MotionSettings, SearchSettings
from tests.unit.particle_filter.rooms import model_of, plain_room, seen_from

HERE = np.array([1.0, 3.0, 0.3])
STILL = MotionSettings(
    turn_noise_per_turn=0.0,
    turn_noise_per_metre=0.0,
    drive_noise_per_metre=0.0,
    drive_noise_per_turn=0.0,
    strafe_noise_per_metre=0.0,
)
RULES = SearchSettings(
    shards=2,
    particles=200,
    annealing_steps=4,
    annealing_start_fraction=0.2,
    jitter_m=0.1,
    jitter_rad=0.3,
)


def search_from(start: np.ndarray, rules: SearchSettings = RULES) -> GlobalSearch:
    return GlobalSearch(model_of(plain_room()), FilterSettings(search=rules, motion=STILL), start)


def run(search: GlobalSearch, steps: int) -> list[float]:
    """Stand still; returns log average likelihoods."""
    beams, rng, gained = seen_from(HERE, plain_room()), np.random.default_rng(0), []
    for _ in range(steps):
        before = HERE if search.steps else None
        result = search.advance(before, HERE, beams, rng)
        gained.append(result.log_weight_sum - math.log(len(search.cloud.log_weights)))
    return gained


def test_the_evidence_of_all_steps_is_gathered() -> None:
    search = search_from(
        np.tile(HERE, (400, 1)) + np.random.default_rng(1).normal(0, 0.1, (400, 3))
    )
    assert search.log_evidence == 0.0
    gained = run(search, 5)
    assert search.log_evidence == pytest.approx(sum(gained))
    assert abs(gained[-1]) > 0.01
    assert search.log_evidence != pytest.approx(gained[-1])


def test_the_exponent_rises_evenly_to_its_full_value_and_stays() -> None:
    search, model = search_from(HERE[None]), model_of(plain_room())
    gained = run(search, 6)
    full = weighed(
        Cloud.even(HERE[None]),
        seen_from(HERE, plain_room()),
        model,
        model.settings.scan_likelihood_exponent,
    ).log_weight_sum
    # One particle, and jitter comes with a redraw only: the same pose each time.
    np.testing.assert_allclose(np.array(gained) / full, [0.2, 0.4, 0.6, 0.8, 1.0, 1.0], rtol=1e-6)


def test_it_is_annealed_after_its_steps_and_not_before() -> None:
    search = search_from(HERE[None])
    said = []
    for _ in range(5):
        run(search, 1)
        said.append(search.annealed)
    assert said == [False, False, False, True, True]


def test_particles_shrink_evenly_in_the_logarithm_to_a_shards_part() -> None:
    """From 1,600 to 100, a half every step; the first scan is weighed by all."""
    search, counts = search_from(np.tile(HERE, (1600, 1))), []
    for _ in range(7):
        run(search, 1)
        counts.append(len(search.cloud.log_weights))
    assert counts == [1600, 800, 400, 200, 100, 100, 100]


def test_jitter_fades_with_every_step_and_ends() -> None:
    """Particles of one pose, redrawn because fewer are wanted, spread by the jitter alone."""
    spreads = []
    for steps in (1, 2, 3, 4):
        search = search_from(np.tile(HERE, (200_000, 1)))
        run(search, steps)
        search.cloud = Cloud.even(np.tile(HERE, (100_000, 1)))
        search._redraw(np.random.default_rng(0))
        spreads.append(search.cloud.map_from_robot.std(axis=0))
    # From 100,000 particles 30,000 and more are drawn at first, in the end 100 in one place.
    fading = np.array([0.75, 0.5, 0.25, 0.0])[:, None]
    np.testing.assert_allclose(spreads, fading * [0.1, 0.1, 0.3], rtol=0.05, atol=1e-12)


def test_few_that_count_are_redrawn_even_when_no_fewer_are_wanted() -> None:
    search = search_from(np.tile(HERE, (100, 1)))
    run(search, 5)
    uneven = np.where(np.arange(100) < 10, 0.0, -50.0)
    poses = np.arange(300.0).reshape(100, 3)
    search.cloud = Cloud(poses, uneven)
    search._redraw(np.random.default_rng(0))
    assert len(np.unique(search.cloud.map_from_robot[:, 0])) == 10
    np.testing.assert_array_equal(search.cloud.log_weights, np.zeros(100))
    half = Cloud(poses, np.where(np.arange(100) < 51, 0.0, -800.0))
    search.cloud = half
    search._redraw(np.random.default_rng(0))
    assert search.cloud is half, "enough count"


def test_places_have_the_share_of_their_weight_and_samples_drawn_by_it() -> None:
    here, there = np.array([1.0, 1.0, 0.0]), np.array([4.0, 1.0, 0.0])
    poses = np.concatenate([np.tile(here, (10, 1)), np.tile(there, (30, 1))])
    poses[5:10, 1] += 0.2  # half of those here stand a little aside, and count thrice
    weights = np.concatenate([np.full(5, 3.0), np.full(5, 9.0), np.full(30, 2.0)])
    rules = SearchSettings(hand_over_particles=400)
    rng = np.random.default_rng(0)
    first, second = places_of(Cloud(poses, np.log(weights)), rules, 0.01, rng)
    assert (first.share, second.share) == pytest.approx((0.5, 0.5))
    aside = first if first.mean[0] < 2.0 else second
    assert aside.mean == pytest.approx([1.0, 1.15, 0.0])
    assert aside.covariance[1, 1] == pytest.approx(0.75 * 0.25 * 0.04)
    assert np.mean(aside.sample[:, 1] > 1.1) == pytest.approx(0.75, abs=0.003)
    assert len(aside.sample) == 400
    few = places_of(Cloud(poses, np.log(weights)), rules, 0.51, rng)
    assert few == [], "none has so much"
