import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from clustermcl.filter.arrays import OCCUPIED, UNKNOWN, Cells, Pose
from clustermcl.filter.laser.beam_fits import beam_fits, decoded
from clustermcl.filter.laser.evidence_model import THROUGH_WEIGHT, scan_exponent, through_beam_loss
from clustermcl.filter.laser.sensor_model import Beams
from clustermcl.filter.observations.fixes import PoseFix
from clustermcl.filter.observations.kind import NO_LANDMARKS
from clustermcl.filter.poses import compose, heading_distance
from clustermcl.filter.search.global_search import GlobalSearch
from clustermcl.filter.search.places import FoundPlace
from clustermcl.filter.settings import BeliefSettings, FilterSettings, SearchSettings
from clustermcl.filter.slices import finished
from tests.unit.filter.rooms import model_of, plain_room, seen_from, symmetric_room

START = np.array([1.0, 3.2, -0.4])
LITERAL = BeliefSettings(piece_evidence=0.0)
"""Each scan counts in full."""


def search_in(
    cells: Cells, poses: int = 6_000, *, belief: BeliefSettings = LITERAL, model: Any = None
) -> GlobalSearch:
    settings = FilterSettings(belief=belief, search=SearchSettings(poses=poses, shards=1))
    return GlobalSearch(model or model_of(cells), settings, shard=0)


def places_after(
    search: GlobalSearch, cells: Cells, poses: Iterable[Pose], seed: int = 0
) -> list[FoundPlace]:
    rng, before = np.random.default_rng(seed), None
    for pose in poses:
        finished(search.advance(before, pose, seen_from(pose, cells), rng))
        before = pose
    return finished(search.places(np.random.default_rng(0)))


def curve(steps: int) -> list[Pose]:
    return [START + step * np.array([0.15, -0.05, 0.05]) for step in range(steps)]


def is_near(pose: np.ndarray, truth: np.ndarray) -> bool:
    near = math.dist(pose[:2], truth[:2]) < 0.3
    return near and float(heading_distance(pose[2], truth[2])) < 0.2


@pytest.mark.parametrize(("steps", "share"), [(1, 0.5), (2, 0.8), (10, 0.99)])
def test_a_search_finds_a_unique_place_from_the_first_scan_on(steps: int, share: float) -> None:
    poses = curve(steps)
    best = places_after(search_in(plain_room()), plain_room(), poses)[0]
    assert is_near(best.mean, poses[-1])
    assert best.share > share


def test_a_search_finds_two_places_that_look_alike_in_ten_of_ten_runs() -> None:
    poses = curve(10)
    turned = poses[-1] * [-1.0, -1.0, 1.0] + [6.0, 4.0, np.pi]
    for seed in range(10):
        places = places_after(search_in(symmetric_room()), symmetric_room(), poses, seed)
        shares = [
            sum(place.share for place in places if is_near(place.mean, truth))
            for truth in (poses[-1], turned)
        ]
        assert min(shares) > 0.1, f"seed {seed}: {shares}"
        assert sum(shares) > 0.9, f"seed {seed}: {shares}"


def test_the_left_out_gap_shows_whether_leaves_were_sampled() -> None:
    for poses, gap in ((200_000, SearchSettings().margin), (20, 0.0)):
        search = search_in(plain_room(), poses)
        places_after(search, plain_room(), [START])
        assert search.left_out_gap == pytest.approx(gap, abs=1.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("poses", [4, 20])
def test_a_search_with_few_poses_finds_the_place_from_scans_joined_by_odometry(
    poses: int, seed: int
) -> None:
    """The robot turns and drives a metre between scans, so each is of use only at its own pose."""
    drive = [START]
    for _ in range(3):
        drive.append(compose(drive[-1], np.array([0.9, 0.0, 0.7])))
    best = places_after(search_in(plain_room(), poses), plain_room(), drive, seed)[0]
    assert is_near(best.mean, drive[-1])


def test_an_observation_of_the_first_step_counts_in_later_searches_at_the_pose_since() -> None:
    """Of two places that look alike, it shows the right one although the robot has driven on."""
    cells, rng, before = symmetric_room(), np.random.default_rng(0), None
    search = search_in(cells, 20)
    at_start = PoseFix(START, np.diag([0.1, 0.1, 0.1]), 0.05)
    for step in range(4):
        pose = START if before is None else compose(before, np.array([0.5, 0.0, 0.4]))
        observed = ([at_start] if step == 0 else [], NO_LANDMARKS)
        finished(search.advance(before, pose, seen_from(pose, cells), rng, observed))
        before = pose
    best = finished(search.places(rng))[0]
    assert is_near(best.mean, pose)
    assert best.share > 0.9


def test_the_likelihood_of_all_scans_is_kept_when_their_evidence_is_tempered() -> None:
    cells, rng = plain_room(), np.random.default_rng(0)
    search, seen = search_in(cells, belief=BeliefSettings()), seen_from(START, cells)
    for _ in range(8):  # the robot stands, so no further scan adds evidence
        before = search.log_evidence
        finished(search.advance(START, START, seen, rng))
    model = model_of(cells)
    best = model.settings.scan_likelihood_exponent * model.log_likelihood(START[None], seen)[0]
    assert search.log_evidence - before == pytest.approx(best, abs=1.0)
    assert abs(best) > 3.0, "else nothing would be as near"


def test_a_scan_without_a_return_adds_no_evidence() -> None:
    cells, rng = plain_room(), np.random.default_rng(0)
    search, seen = search_in(cells), seen_from(START, cells)
    nothing = Beams(seen.ranges[:0], seen.angles[:0], seen.robot_from_laser)
    finished(search.advance(None, START, nothing, rng))
    assert finished(search.places(rng)) == []
    assert (search.poses, search.log_evidence) == (0, 0.0)
    finished(search.advance(START, START, seen, rng))
    assert is_near(finished(search.places(rng))[0].mean, START)
    finished(search.advance(START, START, nothing, rng))
    assert is_near(finished(search.places(rng))[0].mean, START)


def test_a_map_without_a_free_cell_is_refused() -> None:
    cells = np.full((30, 30), UNKNOWN, np.int8)
    cells[10, 10] = 1
    with pytest.raises(ValueError, match="no free cell"):
        search_in(cells)


def test_a_place_loses_what_beams_through_walls_explain_once_for_a_standing_robot() -> None:
    """Of two places alike, a wall stands in the view of the far one."""
    seen, cells = seen_from(START, symmetric_room()), symmetric_room()
    cells[4:28, 90] = OCCUPIED
    model, far = model_of(cells), np.array([5.0, 0.8, math.pi - 0.4])
    fits, through = decoded(beam_fits(far, seen, model, mirrored=False))
    explained = through_beam_loss(model.settings) * float(fits @ through)
    lost = THROUGH_WEIGHT * scan_exponent(seen.count, model.settings) * explained
    assert lost > 0.4
    shares = {}
    for belief in (LITERAL, BeliefSettings()):
        search, rng = search_in(cells, belief=belief), np.random.default_rng(0)
        before, far_side = None, []
        for _ in range(6):
            finished(search.advance(before, START, seen, rng))
            places = finished(search.places(np.random.default_rng(0)))
            far_side.append(sum(place.share for place in places if place.mean[0] > 3.0))
            before = START
        shares[belief] = far_side
    as_it_fits, without = shares.values()
    odds = as_it_fits[0] / (1.0 - as_it_fits[0]) * math.exp(-lost)
    assert without[0] == pytest.approx(odds / (1.0 + odds), abs=0.05)
    np.testing.assert_allclose(without, without[0], atol=0.03)
