import math

import msgspec
import pytest

from clustermcl.belief.cluster_set import ClusterSet
from clustermcl.belief.familiarity import BEST, CORRELATED, FIRST, MOST, USUAL, Familiarity, Learned
from clustermcl.filter.laser.evidence_model import through_beam_loss
from clustermcl.filter.settings import BeliefSettings, FilterSettings, SensorSettings


def after(share: float, pieces: int) -> Familiarity:
    found = Familiarity()
    for _ in range(pieces):
        found = found.after(1.0, share)
    return found


def of_a_piece(found: Familiarity, least: float = 0.7) -> float:
    settings = FilterSettings(belief=BeliefSettings(piece_evidence=least))
    return ClusterSet(settings, learned=Learned(found)).piece_evidence


def test_a_piece_is_worth_more_where_the_map_has_explained_more() -> None:
    worth = [of_a_piece(after(share, 200)) for share in (0.5, 0.85, 0.9, 0.99)]
    assert worth == sorted(worth)
    assert worth[0] == 0.7, "a map that explains little may still be the right one"
    learned = (200 * 0.9 + FIRST * USUAL) / (200 + FIRST)
    assert worth[2] == pytest.approx(CORRELATED * math.log(learned / (1.0 - learned)))
    assert of_a_piece(after(1.0, 10_000)) == CORRELATED * math.log(BEST / (1.0 - BEST))


def test_what_the_map_was_is_forgotten() -> None:
    found = after(1.0, 10_000)
    assert found.new == pytest.approx(MOST)
    for _ in range(2_000):
        found = found.after(1.0, 0.5)
    assert found.share == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_evidence_of_a_piece_is_bounded_for_ever(share: float) -> None:
    found = after(share, 100_000)
    again = msgspec.msgpack.decode(msgspec.msgpack.encode(found), type=Familiarity)
    assert 0.7 <= of_a_piece(again) <= CORRELATED * math.log(BEST / (1.0 - BEST))


def test_without_evidence_of_pieces_familiarity_gives_none() -> None:
    assert of_a_piece(after(1.0, 100), 0.0) == 0.0


def test_a_building_has_changed_the_more_the_less_fits_in_front_of_walls() -> None:
    changed = [
        Learned(in_front=after(front, 200)).changed(of_a_piece(after(fits, 200)))
        for fits, front in ((0.9, 0.3), (0.9, 0.7), (0.99, 0.9))
    ]
    assert changed[0] == 1.0
    assert changed == sorted(changed, reverse=True)
    assert 0.0 < changed[-1] < 0.5
    assert Learned(in_front=after(1.0, 200)).changed(0.7) == 0.0, "no less than nothing"
    assert 0.4 < Learned().changed(0.7) < 0.7


def test_which_place_explains_one_more_piece_is_chance_only_in_a_changed_building() -> None:
    best, learned = Familiarity.of(0.9), Learned(others=Familiarity.of(0.7))
    assert learned.evidence_among(best, 0.0) == best.evidence
    of_others = CORRELATED * math.log(0.7 / 0.3)
    for changed, chance in ((0.5, 0.75), (1.0, 1.0)):
        expected = best.evidence - chance * of_others
        assert learned.evidence_among(best, changed) == pytest.approx(expected)
    assert learned.evidence_among(Familiarity.of(0.6), 1.0) == 0.0, "fewer pieces are no evidence"


def test_beams_fit_the_more_sharply_the_less_the_building_has_changed() -> None:
    ratio = through_beam_loss(SensorSettings())
    shares = (0.3, 0.7, 0.97)
    sharp = [
        ClusterSet(learned=Learned(after(0.97, 500), after(front, 500))).sharpness
        for front in shares
    ]
    assert sharp[0] == 0.0
    assert sharp == sorted(sharp)
    assert 0.9 * ratio < sharp[-1] <= ratio
    without = FilterSettings(belief=BeliefSettings(piece_evidence=0.0))
    assert ClusterSet(without).sharpness == 0.0
