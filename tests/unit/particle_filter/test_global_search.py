import math

import numpy as np
import pytest

from particle_filter.arrays import UNKNOWN
from particle_filter.global_search import GlobalSearch
from particle_filter.poses import compose, heading_distance
from particle_filter.sensor_model import Beams, SensorModel
from particle_filter.settings import BeliefSettings, FilterSettings, SearchSettings
from particle_filter.slices import finished
from tests.unit.particle_filter.rooms import (
    beam_model_of,
    model_of,
    plain_room,
    seen_from,
    symmetric_room,
)

START = np.array([1.0, 3.2, -0.4])
LITERAL = BeliefSettings(view_distance_m=0.0, evidence_residual=math.inf)
"""Each scan counts in full."""
SETTINGS = FilterSettings(belief=LITERAL, search=SearchSettings(poses=6_000, shards=1))


def searched(cells: np.ndarray, steps: int, seed: int) -> GlobalSearch:
    """A search fed with perfect scans of a robot that drives a gentle curve."""
    rng = np.random.default_rng(seed)
    search = GlobalSearch(model_of(cells), SETTINGS, shard=0)
    before = None
    for step in range(steps):
        pose = pose_at(step)
        finished(search.advance(before, pose, seen_from(pose, cells), rng))
        before = pose
    return search


def pose_at(step: int) -> np.ndarray:
    return START + step * np.array([0.15, -0.05, 0.05])


def is_near(pose: np.ndarray, truth: np.ndarray) -> bool:
    near = math.dist(pose[:2], truth[:2]) < 0.3
    return near and float(heading_distance(pose[2], truth[2])) < 0.2


@pytest.mark.parametrize(("steps", "share"), [(1, 0.5), (2, 0.8), (10, 0.99)])
def test_a_search_finds_a_unique_place_from_the_first_scan_on(steps: int, share: float) -> None:
    search = searched(plain_room(), steps, seed=0)
    best = finished(search.places(np.random.default_rng(0)))[0]
    assert is_near(best.mean, pose_at(steps - 1))
    assert best.share > share


def test_a_search_finds_two_places_that_look_alike_in_ten_of_ten_runs() -> None:
    turned = pose_at(9) * [-1.0, -1.0, 1.0] + [6.0, 4.0, np.pi]
    for seed in range(10):
        places = finished(
            searched(symmetric_room(), steps=10, seed=seed).places(np.random.default_rng(0))
        )
        shares = [
            sum(place.share for place in places if is_near(place.mean, truth))
            for truth in (pose_at(9), turned)
        ]
        assert min(shares) > 0.1, f"seed {seed}: {shares}"
        assert sum(shares) > 0.9, f"seed {seed}: {shares}"


def test_the_left_out_gap_shows_whether_leaves_were_sampled() -> None:
    cells, rng = plain_room(), np.random.default_rng(0)
    for poses, gap in ((200_000, SETTINGS.search.margin), (20, 0.0)):
        settings = FilterSettings(search=SearchSettings(poses=poses, shards=1))
        search = GlobalSearch(model_of(cells), settings, shard=0)
        finished(search.advance(None, START, seen_from(START, cells), rng))
        assert search.left_out_gap == pytest.approx(gap, abs=1.0)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("poses", [4, 20])
def test_a_search_with_few_poses_finds_the_place_from_scans_joined_by_odometry(
    poses: int, seed: int
) -> None:
    """The robot turns and drives a metre between scans, so each is of use only at its own pose."""
    cells, rng = plain_room(), np.random.default_rng(seed)
    settings = FilterSettings(belief=LITERAL, search=SearchSettings(poses=poses, shards=1))
    search = GlobalSearch(model_of(cells), settings, shard=0)
    before, pose = None, START
    for _ in range(4):
        finished(search.advance(before, pose, seen_from(pose, cells), rng))
        before, pose = pose, compose(pose, np.array([0.9, 0.0, 0.7]))
    best = finished(search.places(np.random.default_rng(0)))[0]
    assert before is not None
    assert is_near(best.mean, before)


def test_the_likelihood_of_all_scans_is_kept_when_their_evidence_is_tempered() -> None:
    cells, rng = plain_room(), np.random.default_rng(0)
    settings = FilterSettings(belief=BeliefSettings(), search=SETTINGS.search)
    search, seen = GlobalSearch(model_of(cells), settings, shard=0), seen_from(START, cells)
    for _ in range(8):  # the robot stands, so no further scan adds evidence
        before = search.log_evidence
        per_beam = finished(search.advance(START, START, seen, rng))
    model = model_of(cells)
    best = model.settings.scan_likelihood_exponent * seen.count * per_beam
    assert search.log_evidence - before == pytest.approx(best, abs=1.0)
    assert abs(best) > 3.0, "else nothing would be as near"


def test_a_scan_without_a_return_adds_no_evidence() -> None:
    cells, rng = plain_room(), np.random.default_rng(0)
    search = GlobalSearch(model_of(cells), SETTINGS, shard=0)
    seen = seen_from(START, cells)
    nothing = type(seen)(seen.ranges[:0], seen.angles[:0], seen.robot_from_laser, 20.0)
    assert math.isnan(finished(search.advance(None, START, nothing, rng)))
    assert finished(search.places(rng)) == []
    assert search.log_evidence == 0.0
    finished(search.advance(START, START, seen, rng))
    assert is_near(finished(search.places(rng))[0].mean, START)
    finished(search.advance(START, START, nothing, rng))
    assert is_near(finished(search.places(rng))[0].mean, START)


def test_a_beam_model_is_searched_too() -> None:
    cells, rng = plain_room(), np.random.default_rng(0)
    search = GlobalSearch(beam_model_of(cells), SETTINGS, shard=0)
    finished(search.advance(None, START, seen_from(START, cells), rng))
    assert is_near(finished(search.places(rng))[0].mean, START)


def test_a_map_without_a_free_cell_is_refused() -> None:
    cells = np.full((30, 30), UNKNOWN, np.int8)
    cells[10, 10] = 1
    with pytest.raises(ValueError, match="no free cell"):
        GlobalSearch(model_of(cells), SETTINGS, shard=0)


class Corrected:
    """A model whose second scan cancels the first everywhere."""

    def __init__(self, cells: np.ndarray, correction: float) -> None:
        self._model, self._correction = model_of(cells), correction

    def __getattr__(self, name: str) -> object:
        return getattr(self._model, name)

    def correction(
        self, poses: np.ndarray, weights: np.ndarray, _beams: Beams, sharers: int
    ) -> float:
        assert len(poses) == len(weights)
        assert sharers == SETTINGS.search.shards
        assert float(weights.sum()) == pytest.approx(1.0), "of one place"
        return self._correction


def test_the_evidence_of_a_search_is_corrected_for_occlusion() -> None:
    reported = []
    for correction in (0.0, 2.0):
        model: SensorModel = Corrected(plain_room(), correction)  # type: ignore[assignment] # a twin
        search = GlobalSearch(model, SETTINGS, shard=0)
        finished(
            search.advance(None, START, seen_from(START, plain_room()), np.random.default_rng(0))
        )
        reported.append(search.log_evidence)
    # Places with less than a hundredth are not looked at.
    assert reported[1] - reported[0] == pytest.approx(-2.0, abs=0.1)


class CorrectedFarSide(Corrected):
    """Only on the side of the room where the robot is not."""

    def correction(
        self, poses: np.ndarray, weights: np.ndarray, beams: Beams, sharers: int
    ) -> float:
        taken_back = super().correction(poses, weights, beams, sharers)
        return taken_back if float(weights @ poses[:, 0]) > 3.0 else 0.0


def standing(correction: float) -> tuple[list[float], list[float]]:
    """The share of the far side, and the evidence, after each of six scans."""
    model: SensorModel = CorrectedFarSide(symmetric_room(), correction)  # type: ignore[assignment] # a twin
    settings = FilterSettings(belief=BeliefSettings(), search=SETTINGS.search)
    search, rng = GlobalSearch(model, settings, shard=0), np.random.default_rng(0)
    seen, far_side, reported = seen_from(START, symmetric_room()), [], []
    before = None
    for _ in range(6):
        finished(search.advance(before, START, seen, rng))
        places = finished(search.places(np.random.default_rng(0)))
        far_side.append(sum(place.share for place in places if place.mean[0] > 3.0))
        reported.append(search.log_evidence)
        before = START
    return far_side, reported


def test_a_correction_counts_once_for_a_standing_robot() -> None:
    """The robot stands: no scan after the first is a new view, so its places stay as they are."""
    _, as_given = standing(0.0)
    far_side, reported = standing(2.0)
    assert far_side[0] == pytest.approx(math.exp(-2.0) / (1.0 + math.exp(-2.0)), abs=0.03)
    np.testing.assert_allclose(far_side, far_side[0], atol=0.02)
    # All scans are as likely as they are: what is taken back of them lacks in full.
    lost = math.log1p(far_side[0] * math.expm1(-2.0))
    np.testing.assert_allclose(np.diff(reported) - np.diff(as_given), lost, atol=0.08)
