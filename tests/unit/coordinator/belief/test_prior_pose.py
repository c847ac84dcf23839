from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from clustermcl.belief.admission import first_admission
from clustermcl.belief.cluster_set import Candidate, ClusterSet
from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.given_places import candidate, diagonal
from clustermcl.belief.search_pool import Pool
from clustermcl.filter.random_streams import Purpose
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.protocol.job_events import Began
from tests.unit.coordinator.reports import literal_bayes, place, pool_of, searched

RULES = FilterSettings(search=SearchSettings(shards=1), belief=literal_bayes(max_clusters=3))
ORIGIN = (0.0, 0.0, 0.0)
OFFER = place(0.1, (5.0, 5.0, 0.0), 4)


def with_prior_pose(found: Pool) -> Sequence[Candidate]:
    return first_admission(found, OFFER, ClusterSet(RULES)).entering


def shares(candidates: Sequence[Candidate]) -> list[float]:
    return [candidate.share for candidate, _ in candidates]


def test_the_particles_of_a_given_place_are_those_of_its_covariance_and_its_step() -> None:
    covariance = (4.0, 1.0, 0.0, 1.0, 0.5, 0.0, 0.0, 0.0, 0.09)
    samples = [
        candidate(
            0.5, (5.0, 2.0, 1.0), covariance, seed=0, purpose=Purpose.GIVEN_POSE, entity=1,
            step=step, odom_from_robot=ORIGIN,
        ).sample
        for step in (-1, 0, 3)
    ]  # fmt: skip
    before, first, later = (sample.map_from_robot.array() for sample in samples)
    assert np.all(samples[0].log_weights.array() == 0.0)
    np.testing.assert_array_equal(before, first)
    assert not np.intersect1d(first, later).size
    # Of a thousand, a variance is known to 4.5 % (1 sigma).
    np.testing.assert_allclose(np.cov(later.T).ravel(), covariance, rtol=0.2, atol=0.1)
    np.testing.assert_allclose(later.mean(axis=0), (5.0, 2.0, 1.0), atol=0.25)
    assert diagonal(0.3, 0.2) == pytest.approx((0.09, 0, 0, 0, 0.09, 0, 0, 0, 0.04))


def test_a_prior_pose_becomes_a_hypothesis_next_to_found_places() -> None:
    both = with_prior_pose(pool_of((0.6, (1.0, 1.0, 0.0)), (0.4, (9.0, 1.0, 0.0)), step=9))
    assert shares(both) == pytest.approx([0.54, 0.36, 0.1])
    assert [cause for _, cause in both] == ["first search", "first search", "prior pose"]
    offered, _ = both[2]
    assert offered.pose == (5.0, 5.0, 0.0)
    assert offered.sample.step == 4, "it is tracked from where it was"


def test_a_prior_pose_replaces_the_least_probable_place() -> None:
    places = (0.5, (1.0, 1.0, 0.0)), (0.3, (9.0, 1.0, 0.0)), (0.2, (9.0, 9.0, 0.0))
    assert shares(with_prior_pose(pool_of(*places, step=9))) == pytest.approx([0.45, 0.27, 0.1])


def test_a_prior_pose_is_moved_by_odometry() -> None:
    found = pool_of((1.0, ORIGIN), step=9)
    moved = replace(found.views, odom_from_robot=(2.0, 0.0, 0.0))
    _, (offered, _) = with_prior_pose(replace(found, views=moved))
    assert offered.pose == pytest.approx((7.0, 5.0, 0.0))


def test_a_prior_pose_enters_once_when_the_first_search_has_found_a_place() -> None:
    ensemble = Ensemble.of(RULES)
    ensemble.begin_at(4, OFFER)
    assert ensemble.advance(4, [searched("s0.0", 4, {})]).hypotheses == ()
    assert ensemble.prior_pose is OFFER
    outcome = ensemble.advance(5, [searched("s0.0", 5, {(1.0, 1.0, 0.0): 1.0})])
    assert [h.probability for h in outcome.hypotheses] == pytest.approx([0.9, 0.1])
    assert outcome.events[:2] == (
        Began("c0", "first search", pytest.approx(0.9)),
        Began("c1", "prior pose", pytest.approx(0.1)),
    )
    job = outcome.begin["c1"]
    assert job.start.step == 4
    assert ensemble.prior_pose is None
