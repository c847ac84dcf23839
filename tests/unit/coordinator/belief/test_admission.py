import math

import numpy as np
import pytest
from msgspec.structs import replace

from clustermcl.belief.admission import (
    MOST_LOG,
    Admission,
    admission,
    first_admission,
    log_weight_of_held,
)
from clustermcl.belief.cluster_set import Cluster, ClusterSet
from clustermcl.belief.search_pool import Pool
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.pose_arrays import covariance_tuple
from tests.unit.coordinator.reports import literal_bayes, pool_of

SETTINGS = FilterSettings(
    search=SearchSettings(source_radius_m=1.0, source_heading_rad=0.5),
    belief=literal_bayes(max_clusters=4, candidate_probability=0.02, least_probability=0.001),
)
HELD: list[PoseTuple] = [(0.0, 0.0, 0.0)]
FAR, FARTHER, LEAST = (9.0, 0.0, 0.0), (9.0, 9.0, 0.0), (0.0, 9.0, 0.0)
NEARBY = (0.7, 0.0, 0.0)
"""From the held place: too near for a search to separate them."""
NO_EVIDENCE = -math.inf


def with_belief(**belief: object) -> FilterSettings:
    return replace(SETTINGS, belief=replace(SETTINGS.belief, **belief))


def pool(*found: tuple[float, PoseTuple]) -> Pool:
    return pool_of(*found, step=7)


def admitted(
    found: Pool,
    log_weight: float,
    room: tuple[float, ...] = (0.0, 0.0, 0.0, 1e-9),
    *,
    first_step: int = 2,
    is_over: bool = False,
    **belief: object,
) -> Admission:
    """Next to a cluster at `HELD`, which began at step 1, and older ones far away."""
    settings = with_belief(max_clusters=len(room), **belief)
    clusters = ClusterSet(settings, log_elsewhere=log_weight, log_off_map=-math.inf)
    then = {}
    for number, probability in enumerate(probability for probability in room if probability > 0.0):
        pose = (-100.0 * number, 0.0, 0.0)
        born, spread = 1 if number == 0 else 0, covariance_tuple(np.eye(3))
        cluster = Cluster(number, math.log(probability), born, pose, spread)
        clusters.clusters[number], then[cluster.job_id] = cluster, pose
    return admission(found, clusters, then, first_step, "restart", is_over=is_over)


def own(found: Pool, probability: float, *, is_over: bool = False) -> Admission:
    """Of the search that found the cluster of this probability; elsewhere is impossible."""
    room = (0.0, 0.0, 0.0, probability)
    return admitted(found, NO_EVIDENCE, room, first_step=1, is_over=is_over)


def entered(
    found: Pool,
    log_weight: float,
    room: tuple[float, ...] = (0.0, 0.0, 0.0, 1e-9),
    *,
    is_over: bool = False,
    **belief: object,
) -> dict[PoseTuple, float]:
    fresh = admitted(found, log_weight, room, is_over=is_over, **belief).entering
    return {place.pose: place.share for place, _ in fresh}


# --- beside clusters ----------------------------------------------------------------------------


def test_places_with_almost_no_share_replace_no_cluster() -> None:
    """However they weigh beside clusters that a search has brought and that are nothing now."""
    for log_weight in (50.0, -1.0):
        held = (1e-18 / math.exp(log_weight), HELD[0])
        found = pool((0.3, FAR), (0.3, FARTHER), (0.3, LEAST), held)
        came = admitted(found, 0.0, (0.0, 1e-18, 0.9995), first_step=1)
        assert (len(came.entering), len(came.earlier)) == (1, 1), "only where room is free"


def test_the_weight_of_a_place_is_its_share_of_the_search() -> None:
    found = pool((0.4, HELD[0]), (0.35, FAR), (0.25, FARTHER))
    weights = entered(found, math.log(3.0))
    assert list(weights) == [FAR, FARTHER], "what a cluster holds does not enter"
    assert weights == pytest.approx({FAR: 1.05, FARTHER: 0.75})


def on_trial(found: Pool, log_weight: float, **belief: object) -> dict[PoseTuple, float]:
    return entered(found, log_weight, is_over=True, **belief)


def test_places_of_a_finished_search_have_at_least_the_configured_probability() -> None:
    found = pool((0.5, FAR), (0.3, HELD[0]), (0.1, FARTHER), (0.04, LEAST))
    trial = {FAR: 0.01, FARTHER: 0.002}
    assert on_trial(found, NO_EVIDENCE) == pytest.approx(trial), "0.0008 is too improbable"
    assert entered(found, NO_EVIDENCE) == {}, "it may yet see what distinguishes them"
    assert on_trial(found, NO_EVIDENCE, candidate_probability=0.0) == {}
    earned = {FAR: 0.05, FARTHER: 0.01, LEAST: 0.004}
    assert on_trial(found, math.log(0.1)) == pytest.approx(earned), "it is worth more"


def test_places_of_the_search_that_found_the_clusters_get_no_minimum_probability() -> None:
    found = pool((0.5, FAR), (0.4, HELD[0]))
    for weight, came in ((0.01, [0.005]), (1e-9, [])):
        places = own(found, 0.4 * weight, is_over=True)
        weights = [place.share / places.kept for place, _ in places.entering]
        assert weights == pytest.approx(came)


def test_the_search_that_found_the_clusters_has_no_further_candidates() -> None:
    found = pool((0.6, NEARBY), (0.4, FAR))
    came = own(found, 0.6)
    assert [place.pose for place, _ in came.entering] == [FAR]
    turned = (0.0, 0.0, 0.45)
    came = own(pool((0.6, turned), (0.4, FAR)), 0.6)
    assert [place.pose for place, _ in came.entering] == [FAR], "nor does a search resolve headings"


def test_a_place_next_to_a_cluster_does_not_enter() -> None:
    found = pool((0.6, NEARBY), (0.4, FAR))
    assert on_trial(found, NO_EVIDENCE) == pytest.approx({FAR: 0.008})
    assert on_trial(found, math.log(0.1)) == pytest.approx({FAR: 0.04})


def test_a_place_is_near_only_if_both_position_and_heading_are() -> None:
    turned, aside = (0.0, 0.0, 0.51), (1.01, 0.0, 0.0)
    found = pool((0.3, turned), (0.3, aside), (0.3, (0.7, 0.7, 0.49)))
    assert set(entered(found, 0.0)) == {turned, aside}


def test_no_more_probable_cluster_is_replaced_by_a_candidate() -> None:
    found = pool((0.5, FAR), (0.3, FARTHER), (0.2, LEAST))
    assert set(entered(found, 0.0, (0.0, 0.2, 0.25))) == {FAR, FARTHER}
    assert set(entered(found, 0.0, (0.0, 0.31, 0.4))) == {FAR}
    assert set(entered(found, 0.0, (0.5,))) == set()


def test_places_that_are_too_improbable_do_not_enter() -> None:
    found = pool((0.09, FAR), (0.05, FARTHER))
    assert set(entered(found, 0.0, least_probability=0.06)) == {FAR}
    assert set(entered(found, 0.0, least_probability=0.05)) == {FAR, FARTHER}, "just enough"


def test_weights_stay_finite_however_much_better_a_search_fits() -> None:
    most = math.exp(MOST_LOG)
    weights = entered(pool((0.75, FAR), (0.25, FARTHER)), 1e6)
    assert weights == pytest.approx({FAR: 0.75 * most, FARTHER: 0.25 * most}), "as they share"


def test_later_places_of_a_search_take_weight_only_from_its_first_places() -> None:
    """The search's place has 0.3 of the belief, and one found later 3/4 of its share."""
    clusters = ClusterSet(SETTINGS, next_cluster=2)
    for number, (probability, pose) in enumerate(((0.7, LEAST), (0.3, HELD[0]))):
        spread = covariance_tuple(np.eye(3))
        clusters.clusters[number] = Cluster(number, math.log(probability), number, pose, spread)
    then = {cluster.job_id: cluster.pose for cluster in clusters.all()}
    found = pool((0.4, HELD[0]), (0.3, FAR))
    came = admission(found, clusters, then, 1, "restart")
    came.make_way(clusters)
    clusters.admit(came.entering, 6)
    after = [cluster.probability for cluster in clusters.all()]
    assert after == pytest.approx([0.7, 0.3 / 1.75, 0.225 / 1.75])


# --- first places -------------------------------------------------------------------------------


def first_shares(found: Pool, **belief: object) -> list[float]:
    clusters = ClusterSet(with_belief(**belief), log_elsewhere=0.0, log_off_map=-math.inf)
    return [place.share for place, _ in first_admission(found, None, clusters).entering]


def test_first_places_are_limited_in_number_and_by_probability() -> None:
    found = pool((0.6, FAR), (0.3, FARTHER), (0.0005, LEAST))
    assert len(first_shares(found)) == 2
    assert len(first_shares(found, max_clusters=1)) == 1
    assert len(first_shares(found, least_probability=0.0)) == 3
    assert first_shares(pool()) == []


def test_the_weight_of_the_search_that_found_the_clusters_is_that_of_the_clusters() -> None:
    """It holds places with half of it that have 0.4 of the belief: the whole weighs 0.8."""
    found = pool((0.3, HELD[0]), (0.2, FAR), (0.5, FARTHER))
    held: list[tuple[PoseTuple, float]] = [(HELD[0], 0.25), (FAR, 0.15), (LEAST, 0.6)]
    weight = log_weight_of_held(found, held, SETTINGS.search)
    assert weight == pytest.approx(math.log(0.8))
    assert log_weight_of_held(found, [(LEAST, 1.0)], SETTINGS.search) is None
    assert log_weight_of_held(pool(), held, SETTINGS.search) is None
