"""Who enters beside the clusters and with what; clouds round given places; how places are told."""

import math

import numpy as np
import pytest

from coordinator.belief.admission import Terms, newcomers, terms
from coordinator.belief.cluster_set import ClusterSet
from coordinator.belief.fit_monitor import FitMonitor, FitState
from coordinator.belief.given_places import cloud, diagonal
from coordinator.belief.outcome import places_of
from coordinator.belief.search_pool import Pool
from particle_filter.settings import BeliefSettings, FilterSettings, SearchSettings
from protocol.message import PoseTuple
from protocol.pose_arrays import covariance_tuple
from tests.unit.coordinator.reports import place

SETTINGS = FilterSettings(
    search=SearchSettings(source_radius_m=1.0, source_heading_rad=0.5),
    belief=BeliefSettings(clusters=4, merge_distance_m=0.5, merge_heading_rad=0.35),
)
HELD: list[PoseTuple] = [(0.0, 0.0, 0.0)]


def pool(*found: tuple[float, PoseTuple], fit: float = -1.0) -> Pool:
    return Pool(7, tuple(place(share, mean, 7) for share, mean in found), 0.0, 12.0, fit)


def entered(found: Pool, yielding: list[float], given: Terms) -> list[tuple[PoseTuple, float]]:
    fresh = newcomers(found, HELD, yielding, 1.0, given, SETTINGS)
    return [(place.mean, place.share) for place in fresh]


def test_newcomers_share_what_is_given_by_their_shares_of_the_search() -> None:
    far, farther, least = (9.0, 0.0, 0.0), (9.0, 9.0, 0.0), (0.0, 9.0, 0.0)
    found = pool((0.3, HELD[0]), (0.4, far), (0.2, farther), (0.1, least))
    given = Terms(most=2, least_share=0.1, probability=0.06, replaces_alternatives=True)
    assert entered(found, [0.0, 0.0, 0.0], given) == [
        (far, pytest.approx(0.04)),
        (farther, pytest.approx(0.02)),
    ]
    assert entered(found, [0.0], given) == [(far, pytest.approx(0.06))]
    assert entered(found, [], given) == []
    all_of_them = Terms(most=9, least_share=0.1, probability=0.07, replaces_alternatives=True)
    assert len(entered(found, [0.0] * 9, all_of_them)) == 3
    only_large = Terms(most=9, least_share=0.11, probability=0.07, replaces_alternatives=True)
    assert len(entered(found, [0.0] * 9, only_large)) == 2


def test_one_that_stays_out_leaves_its_part_to_the_others() -> None:
    """The one beside a cluster comes last, and nobody more probable leaves for it."""
    beside, far = (0.7, 0.0, 0.0), (9.0, 0.0, 0.0)
    found = pool((0.5, beside), (0.5, far))
    given = Terms(most=2, least_share=0.1, probability=0.1, replaces_alternatives=True)
    assert entered(found, [0.2, 0.3], given) == [(far, pytest.approx(0.1))]
    both = entered(found, [0.2, 0.04], given)
    assert both == [(far, pytest.approx(0.05)), (beside, pytest.approx(0.05))]


def test_a_place_is_near_only_in_place_and_heading() -> None:
    turned, aside = (0.0, 0.0, 0.36), (0.51, 0.0, 0.0)
    given = Terms(most=3, least_share=0.0, probability=0.1, replaces_alternatives=True)
    found = pool((0.3, turned), (0.3, aside), (0.3, (0.3, 0.3, 0.3)))
    assert {mean for mean, _ in entered(found, [0.0] * 4, given)} == {turned, aside}


@pytest.mark.parametrize(
    ("lost", "fit", "expected"),
    [
        (False, -1.0, Terms(3, 0.1, 0.02, False)),
        (True, -1.39, Terms(8, 0.01, 0.3, True)),
        (True, -1.41, Terms(3, 0.1, 0.1, True)),
    ],
    ids=["tracking", "lost and found", "lost among people"],
)
def test_terms_follow_from_whether_it_is_lost_and_what_fits(
    lost: bool, fit: float, expected: Terms
) -> None:
    rules = BeliefSettings()
    monitor = FitMonitor(rules)
    monitor.restore(FitState(-1.0, -3.0, lost))
    assert terms(pool(fit=fit), monitor, rules) == expected


def test_a_given_cloud_has_the_mean_and_covariance_that_were_given() -> None:
    spread = np.array([[0.5, 0.1, 0.0], [0.1, 0.2, 0.03], [0.0, 0.03, 0.04]])
    rng = np.random.default_rng(0)
    made = cloud((3.0, -2.0, 0.5), covariance_tuple(spread), rng, step=4, odom_from_robot=HELD[0])
    poses = made.map_from_robot.array()
    sigma = np.sqrt(np.diag(spread))
    # 1,000 points: means to 0.03 deviations, covariances to 0.05; five times that.
    assert np.all(np.abs(poses.mean(axis=0) - (3.0, -2.0, 0.5)) < 0.16 * sigma)
    assert np.all(np.abs(np.cov(poses.T) - spread) < 0.23 * np.outer(sigma, sigma))
    assert np.all(made.log_weights.array() == 0.0)
    assert diagonal(0.3, 0.2) == pytest.approx((0.09, 0, 0, 0, 0.09, 0, 0, 0, 0.04))


def test_what_a_search_holds_possible_is_told_with_probabilities_that_sum_to_one() -> None:
    told = places_of(pool((0.3, (1.0, 0.0, 0.0)), (0.1, (2.0, 0.0, 0.0))))
    assert [h.probability for h in told] == pytest.approx([0.75, 0.25])
    assert [h.log_probability for h in told] == pytest.approx([math.log(0.75), math.log(0.25)])
    assert [h.cluster for h in told] == [-1, -2]


def test_the_protected_and_the_best_stay_when_improbable_ones_are_dropped() -> None:
    clusters = ClusterSet(BeliefSettings(clusters=4, drop_below_probability=0.2))
    clusters.admit([(place(p, HELD[0], 0), "first search") for p in (0.8, 0.1)], 0)
    clusters.admit([(place(0.1, HELD[0], 0), "restart")], 1, protected_until=5)
    assert [ended.job_id for ended in clusters.drop_improbable(4)] == ["c1"]
    assert math.fsum(cluster.probability for cluster in clusters.all()) == pytest.approx(1.0)
    assert [ended.job_id for ended in clusters.drop_improbable(5)] == ["c2"]
    assert clusters.drop_improbable(99) == []


def test_the_newcomers_probability_is_theirs_and_the_others_share_the_rest() -> None:
    clusters = ClusterSet(BeliefSettings(clusters=3))
    clusters.admit([(place(p, HELD[0], 0), "first search") for p in (0.5, 0.3, 0.2)], 0)
    assert clusters.yielding(0) == pytest.approx([0.2, 0.3, 0.5])
    admitted, _ = clusters.admit([(place(0.36, HELD[0], 1), "restart")], 1, protected_until=9)
    assert [c.probability for c in clusters.all()] == pytest.approx([0.4, 0.24, 0.36])
    assert (admitted[0].born_step, admitted[0].protected_until) == (1, 9)
    assert clusters.yielding(8) == pytest.approx([0.24, 0.4])
    assert clusters.yielding(9) == pytest.approx([0.24, 0.36, 0.4])
