import math

import pytest

from clustermcl.belief.cluster_set import Candidate
from clustermcl.belief.ensemble import Ensemble
from clustermcl.belief.given_places import PriorPose, with_prior_pose
from clustermcl.filter.settings import FilterSettings, SearchSettings
from clustermcl.protocol.job_events import Began
from clustermcl.protocol.message import PoseTuple
from clustermcl.protocol.work import Place
from tests.unit.coordinator.reports import NO_SPREAD, literal_bayes, place, searched

RULES = FilterSettings(search=SearchSettings(shards=1), belief=literal_bayes(max_clusters=3))
ORIGIN = (0.0, 0.0, 0.0)
OFFER = PriorPose(
    step=4, odom_from_robot=ORIGIN, pose=(5.0, 5.0, 0.0), covariance=NO_SPREAD, probability=0.1
)


def found(*places: tuple[float, PoseTuple]) -> list[Place]:
    return [place(share, mean, 9) for share, mean in places]


def shares(candidates: list[Candidate]) -> list[float]:
    return [candidate.share for candidate, _ in candidates]


def test_a_prior_pose_becomes_a_hypothesis_next_to_found_places() -> None:
    both = with_prior_pose(
        found((0.6, (1.0, 1.0, 0.0)), (0.4, (9.0, 1.0, 0.0))), OFFER, ORIGIN, RULES
    )
    assert shares(both) == pytest.approx([0.54, 0.36, 0.1])
    assert [cause for _, cause in both] == ["first search", "first search", "prior pose"]
    offered, _ = both[2]
    assert offered.pose == (5.0, 5.0, 0.0)
    assert offered.sample.step == 4, "it is tracked from where it was"


def test_a_prior_pose_makes_a_found_place_more_probable() -> None:
    both = with_prior_pose(
        found((0.6, (1.0, 1.0, 0.0)), (0.4, (5.2, 5.0, 0.1))), OFFER, ORIGIN, RULES
    )
    assert shares(both) == pytest.approx([0.54, 0.46])
    assert [cause for _, cause in both] == ["first search", "first search"]


def test_a_prior_pose_replaces_the_least_probable_place() -> None:
    three = found((0.5, (1.0, 1.0, 0.0)), (0.3, (9.0, 1.0, 0.0)), (0.2, (9.0, 9.0, 0.0)))
    kept = with_prior_pose(three, OFFER, ORIGIN, RULES)
    assert len(kept) == 3
    assert math.fsum(shares(kept)) == pytest.approx(1.0)
    assert shares(kept)[2] == pytest.approx(0.1)


def test_a_prior_pose_is_moved_by_odometry() -> None:
    _, (offered, _) = with_prior_pose(found((1.0, ORIGIN)), OFFER, (2.0, 0.0, 0.0), RULES)
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
