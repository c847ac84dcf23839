import math

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st

from clustermcl.filter.laser.off_map import (
    BeamClasses,
    MapQuality,
    log_odds_by_decoy,
    log_odds_of_here,
    probability_right,
)

ALL = np.array([1.0])
RIGHT, WRONG = BeamClasses(58, 1, 1, 0), BeamClasses(12, 10, 30, 8)
CRUDE = BeamClasses(40, 2, 14, 4)
"""A right place in a map that lacks doors."""
RESEMBLING = BeamClasses(42, 9, 7, 2)
"""A wrong place in a building that is much alike."""
counts = st.integers(0, 200)
classes = st.builds(BeamClasses, counts, counts, counts, counts).filter(any)


def after(views: list[BeamClasses], new_view: float = 1.0) -> tuple[float, MapQuality]:
    total, quality = 0.0, MapQuality()
    for view in views:
        odds, quality = log_odds_of_here(quality, ALL, [view], new_view)
        total += odds
    return total, quality


def test_short_beams_give_no_evidence() -> None:
    assert after([BeamClasses(0, 0, 0, 60)])[0] == pytest.approx(0.0)
    few, many = BeamClasses(20, 0, 0, 0), BeamClasses(20, 0, 0, 40)
    assert after([few])[0] > after([many])[0] > 0.5, "fewer beams are evidence too"


def test_a_view_seen_before_gives_no_evidence() -> None:
    odds, quality = log_odds_of_here(MapQuality(), ALL, [WRONG], 0.0)
    assert (odds, quality) == (0.0, MapQuality())


def test_a_crude_map_is_learned_and_a_resembling_building_is_not_taken_for_one() -> None:
    odds, quality = after([CRUDE] * 20)
    assert odds > 5.0
    assert quality.crude > 0.9
    assert after([RESEMBLING] * 20)[0] < -3.0


def test_one_odd_view_of_a_right_place_does_not_lose_it() -> None:
    assert after([RIGHT] * 5 + [WRONG])[0] > 2.0
    assert log_odds_of_here(after([RIGHT] * 50)[1], ALL, [WRONG], 1.0)[0] > math.log(0.05) - 0.1


def test_the_share_of_beams_that_people_cut_short_is_learned() -> None:
    among_people, alone = BeamClasses(40, 0, 0, 20), BeamClasses(60, 0, 0, 0)
    assert after([among_people] * 30)[1].short == pytest.approx(1.0 / 3.0, abs=0.01)
    assert after([alone] * 30)[1].short < 0.001
    assert after([alone] * 30, new_view=0.0)[1] == MapQuality()


def test_beam_classes_alone_distinguish_right_and_wrong_places() -> None:
    right, people, wrong = probability_right(
        MapQuality(), [RIGHT, BeamClasses(20, 0, 0, 40), WRONG]
    )
    assert right > 0.9
    assert people > 0.6
    assert wrong < 0.2
    assert probability_right(MapQuality(), [BeamClasses(0, 0, 0, 60)])[0] == pytest.approx(0.5)


def test_one_right_place_among_many_is_evidence_for_being_on_the_map() -> None:
    shares = np.array([0.2, 0.8])
    odds, _ = log_odds_of_here(MapQuality(), shares, [RIGHT, WRONG], 1.0)
    assert odds > 0.0
    assert log_odds_of_here(MapQuality(), shares, [WRONG, WRONG], 1.0)[0] < -2.0


@hypothesis.given(st.lists(classes, min_size=1, max_size=4), st.floats(0.0, 1.0))
def test_any_beam_counts_give_probabilities(seen: list[BeamClasses], new_view: float) -> None:
    shares = np.full(len(seen), 1.0 / len(seen))
    quality = MapQuality()
    for _ in range(5):
        odds, quality = log_odds_of_here(quality, shares, seen, new_view)
        assert math.isfinite(odds)
        assert 0.0 < quality.crude < 1.0
        assert 0.0 < quality.resembling < 1.0
        assert 0.0 <= quality.short <= 1.0


def compared_with_decoy(differences: list[float]) -> tuple[float, MapQuality]:
    total, quality = 0.0, MapQuality()
    for difference in differences:
        odds, quality = log_odds_by_decoy(quality, difference, -0.1, 0.3)
        total += odds
    return total, quality


def test_a_place_that_fits_better_than_the_decoy_is_right() -> None:
    assert compared_with_decoy([0.6] * 10)[0] > 1.0
    assert compared_with_decoy([-0.3] * 10)[0] < -1.0


def test_a_map_that_is_its_own_mirror_image_gives_no_evidence() -> None:
    alike, quality = compared_with_decoy([0.0, 0.02, -0.01] * 10)
    assert quality.alike > 0.99
    odds, _ = log_odds_by_decoy(quality, 0.0, -0.1, 1.0)
    assert odds == pytest.approx(0.0, abs=0.01)
    assert alike > -1.0, "until that is known, little is lost"


def test_a_decoy_gives_no_evidence_for_a_view_seen_before() -> None:
    odds, quality = log_odds_by_decoy(MapQuality(), -2.0, -0.1, 0.0)
    assert odds == pytest.approx(0.0)
    assert quality == MapQuality()


@hypothesis.given(
    st.floats(-50.0, 50.0), st.floats(-700.0, 0.0), st.floats(0.0, 1.0), st.floats(0.001, 0.999)
)
def test_the_evidence_of_a_decoy_is_bounded_and_the_quality_a_probability(
    difference: float, log_here: float, new_view: float, alike: float
) -> None:
    quality = MapQuality(alike=alike)
    odds, learned = log_odds_by_decoy(quality, difference, log_here, new_view)
    assert abs(odds) < 10.0
    assert 0.0 < learned.alike < 1.0
    assert (learned.crude, learned.resembling, learned.short) == (
        quality.crude,
        quality.resembling,
        quality.short,
    )
