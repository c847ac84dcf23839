import math

import numpy as np
import pytest

from clustermcl.belief.bayes_update import weigh
from clustermcl.belief.cluster_set import Cluster, ClusterSet, Given
from clustermcl.belief.decoy import DECOYS, PATIENCE, SCANS, Decoy
from clustermcl.belief.explained import NO_PLACE
from clustermcl.belief.search_course import SearchCourse
from clustermcl.filter.settings import BeliefSettings, FilterSettings, SearchSettings
from clustermcl.protocol.work import SearchReport, TrackJob
from tests.unit.coordinator.reports import NO_SPREAD, searched, tracked

SETTINGS = FilterSettings(search=SearchSettings(shards=1))
PLACES = {(1.0 * i, 5.0 * i, 0.0): 0.2 for i in range(5)}


@pytest.fixture
def decoy() -> Decoy:
    return Decoy(SearchCourse(SETTINGS, mirrored=True))


def reports(step: int) -> list[SearchReport]:
    return [searched("m0.0", step, PLACES)]


def found(decoy: Decoy, first_step: int) -> int:
    """Search for it; returns the step after which it is tracked."""
    for step in range(first_step, first_step + SCANS):
        begin, ended = decoy.follow(step, reports(step), is_open=True)
    assert set(begin) == set(decoy.track_ids)
    jobs = [(job.mirrored, job.exact) for job in begin.values() if isinstance(job, TrackJob)]
    assert jobs == [(True, False)] * len(begin), "particles are drawn around a place"
    assert [event.job_id for event in ended] == ["m0.0"]
    return step


def test_a_decoy_is_searched_for_and_tracked_with_mirrored_scans(decoy: Decoy) -> None:
    begin, _ = decoy.follow(3, [], is_open=True)
    (search,) = begin.values()
    assert (search.mirrored, search.first_step) == (True, 4)
    found(decoy, 4)
    assert decoy.track_ids == ("d0", "d1", "d2")
    assert DECOYS == 3


def test_a_robot_that_is_surely_on_the_map_has_no_decoy(decoy: Decoy) -> None:
    assert decoy.follow(0, [], is_open=False) == ({}, [])
    decoy.follow(1, [], is_open=True)
    step = found(decoy, 2)
    for later in range(step + 1, step + PATIENCE):
        assert decoy.follow(later, [], is_open=False) == ({}, []), "it may be asked again soon"
    begin, ended = decoy.follow(step + PATIENCE, [], is_open=False)
    assert begin == {}
    assert [event.job_id for event in ended] == ["d0", "d1", "d2"]


def test_further_decoys_are_searched_for_while_off_the_map_is_uncertain(decoy: Decoy) -> None:
    decoy.follow(0, [], is_open=True)
    step = found(decoy, 1) + PATIENCE
    begin, ended = decoy.follow(step, [], is_open=True)
    assert list(begin) == ["m1.0"]
    assert (ended, decoy.track_ids) == ([], ("d0", "d1", "d2")), "the old ones stay until then"
    for later in range(step + 1, step + 1 + SCANS):
        decoy.follow(later, [searched("m1.0", later, PLACES)], is_open=True)
    assert decoy.track_ids == ("d3", "d4", "d5")


def test_a_decoy_that_explains_more_counts_more_from_then_on(decoy: Decoy) -> None:
    """Beams through walls explain nothing; a place that is not tracked explains a fifth."""
    decoy.follow(0, [], is_open=True)
    step = found(decoy, 1) + 1
    beams, at = np.ones(4), (2.0, 0.0, 0.0)
    held = ClusterSet(FilterSettings(belief=BeliefSettings(piece_evidence=2.0)))
    fits = {"d0": [1.0] * 4, "d1": [1.0] * 2 + [-1.0] * 2}
    reported = {job: tracked(job, step, 1.0, at, fits=each) for job, each in fits.items()}
    shares, each = np.array([0.2, 0.2, 0.6]), np.exp([8.0, 4.0, NO_PLACE * 8.0])
    for _ in range(2):
        assert decoy.explains(reported, beams, held) == pytest.approx(math.log(shares @ each))
        shares = shares * each / (shares @ each)
    assert [one.pose for one in decoy.places].count(at) == 2
    assert decoy.explains({}, beams, held) is None
    assert decoy.explains(reported, np.zeros(3), held) is None, "the beams of another scan"


def clusters(off_map: float) -> ClusterSet:
    made = ClusterSet()
    here = Cluster(0, math.log(1.0 - off_map), 0, (0.0, 0.0, 0.0), NO_SPREAD)
    made.clusters, made.next_cluster = {0: here}, 1
    made.log_elsewhere, made.log_off_map = -math.inf, math.log(off_map)
    return made


BEAMS = np.full(40, 0.1)
"""How new the piece of each beam is in a view."""


def weighed(off_map: float, share: float, of_decoy: float | None) -> float:
    """P(off the map) after some views of which a place and a decoy explain these shares."""
    made = clusters(off_map)
    for step in range(8):
        here = {"c0": tracked("c0", step, 1.0, (0.0, 0.0, 0.0), fits=explaining(share))}
        image = None if of_decoy is None else of_decoy * 0.7 * float(BEAMS.sum())
        weigh(made, here, beams=BEAMS, decoy=image)
        assert made.outside_clusters + sum(c.probability for c in made.all()) == pytest.approx(1.0)
    return made.off_map


def explaining(share: float) -> list[float]:
    """Fits of beams of which a share ends on walls, and the others beyond."""
    on_walls = round(share * len(BEAMS))
    return [1.0] * on_walls + [-1.0] * (len(BEAMS) - on_walls)


def test_a_place_that_a_decoy_equals_is_not_confirmed_by_its_beams() -> None:
    assert weighed(0.3, 0.8, 0.5) < 0.02
    assert weighed(0.3, 0.8, 0.8) == pytest.approx(0.3, abs=0.02)


def test_a_decoy_that_fits_better_loses_the_robot() -> None:
    assert weighed(0.1, 0.6, 0.9) > 0.9


def test_a_place_that_explains_next_to_nothing_is_none() -> None:
    assert weighed(0.1, 0.05, None) > 0.5
    assert weighed(0.1, 0.05, 0.0) > 0.5


def test_a_place_is_confirmed_without_a_decoy_only_if_the_robot_is_surely_on_the_map() -> None:
    assert weighed(0.3, 0.9, None) == pytest.approx(0.3, abs=0.02)
    assert weighed(0.015, 0.9, None) < 0.001


@pytest.mark.parametrize("is_given", [False, True])
def test_walls_that_have_moved_do_not_lead_a_robot_off_the_map_whose_given_place_held(
    is_given: bool,
) -> None:
    made = clusters(0.001)
    made.given, made.on_map = (Given(), True) if is_given else (None, False)
    for step in range(40):
        fits = explaining(0.9 if step < 16 else 0.05)
        report = tracked("c0", step, 1.0, (0.0, 0.0, 0.0), fits=fits)
        weigh(made, {"c0": report}, beams=BEAMS)
    assert made.outside_clusters < 0.05 if is_given else made.outside_clusters > 0.9
