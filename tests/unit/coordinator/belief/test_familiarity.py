import math

import msgspec
import pytest

from clustermcl.belief.familiarity import BEST, CORRELATED, FIRST, MOST, USUAL, Familiarity


def after(share: float, pieces: int, front: float | None = None) -> Familiarity:
    found = Familiarity()
    for _ in range(pieces):
        found = found.after(1.0, share, share if front is None else front)
    return found


def test_a_piece_is_worth_more_where_the_map_has_explained_more() -> None:
    worth = [after(share, 200).evidence(0.7) for share in (0.5, 0.85, 0.9, 0.99)]
    assert worth == sorted(worth)
    assert worth[0] == 0.7, "a map that explains little may still be the right one"
    learned = (200 * 0.9 + FIRST * USUAL) / (200 + FIRST)
    assert worth[2] == pytest.approx(CORRELATED * math.log(learned / (1.0 - learned)))
    assert after(1.0, 10_000).evidence(0.7) == CORRELATED * math.log(BEST / (1.0 - BEST))


def test_what_the_map_was_is_forgotten() -> None:
    found = after(1.0, 10_000)
    assert found.new == pytest.approx(MOST)
    for _ in range(2_000):
        found = found.after(1.0, 0.5, 0.25)
    assert found.explained / found.new == pytest.approx(0.5, abs=0.02)
    assert found.front / found.new == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_evidence_of_a_piece_is_bounded_for_ever(share: float) -> None:
    found = after(share, 100_000)
    again = msgspec.msgpack.decode(msgspec.msgpack.encode(found), type=Familiarity)
    assert 0.7 <= again.evidence(0.7) <= CORRELATED * math.log(BEST / (1.0 - BEST))


def test_without_evidence_of_pieces_familiarity_gives_none() -> None:
    assert after(1.0, 100).evidence(0.0) == 0.0


def test_pieces_behind_walls_count_less_the_fewer_there_are_at_the_right_place() -> None:
    counted = [found.behind(found.evidence(0.7)) for found in (
        after(0.9, 200, front=0.3), after(0.9, 200, front=0.7), after(0.99, 200, front=0.9),
    )]  # fmt: skip
    assert counted[0] == 1.0, "as much as others, where the building has changed"
    assert counted == sorted(counted, reverse=True)
    assert 0.0 < counted[-1] < 0.5
    assert after(1.0, 200).behind(0.7) == 0.0, "no less than nothing"
    at_first = Familiarity()
    assert 0.4 < at_first.behind(at_first.evidence(0.7)) < 0.7
