import math

import hypothesis
import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clustermcl.filter.laser.pieces import BEFORE_M, DOUBTFUL, MAX_PIECES, PIECE_M, Pieces

WALL = np.array([[3.1, 0.1], [3.2, 0.2]])
"""Two ends in one piece."""


def seen(*ends: np.ndarray, robot: tuple[float, float] = (0.1, 0.1)) -> np.ndarray:
    return np.concatenate((np.array([robot]), *ends))


def test_a_piece_of_wall_counts_once_however_long_the_robot_looks_at_it() -> None:
    pieces, total = Pieces(), 0.0
    for scans in range(1, 200):
        weights, share, pieces = pieces.after(seen(WALL))
        total += weights.sum()
        assert share == pytest.approx(weights.sum() / (2 / (2 + DOUBTFUL))), "of all that is seen"
        assert weights[0] == weights[1]
        assert total == pytest.approx(2 * scans / (2 * scans + DOUBTFUL))
    assert pieces.problem is None


def test_other_pieces_count_in_full() -> None:
    first, _, pieces = Pieces().after(seen(WALL))
    again, _, _ = pieces.after(seen(WALL + np.array([0.0, PIECE_M]), robot=(0.1, 0.1 + PIECE_M)))
    assert again == pytest.approx(first)


def test_what_later_beams_pass_was_no_wall() -> None:
    _, _, pieces = Pieces().after(seen(WALL))
    for _ in range(5):
        _, _, pieces = pieces.after(seen(np.array([[8.1, 0.1]])))
    weights, _, _ = pieces.after(seen(WALL))
    assert weights.sum() == pytest.approx(4 / (4 + 5 + DOUBTFUL) - 2 / (2 + 5 + DOUBTFUL))


def test_a_beam_passes_the_pieces_in_front_of_the_robot_but_not_those_near_its_end() -> None:
    along = np.arange(-3, 30) * PIECE_M + 0.1
    line = seen(np.column_stack((along, np.full(len(along), 0.1))), robot=(5.1, -40.1))
    _, _, pieces = Pieces().after(line)
    without, _, _ = pieces.after(line)
    _, _, pieces = pieces.after(seen(np.array([[9.1, 0.1]])))
    weights, _, _ = pieces.after(line)
    passed = (along > 0.1 + 1e-9) & (along <= 9.1 - BEFORE_M)
    np.testing.assert_array_equal(weights[along < 9.0] < without[along < 9.0], passed[along < 9.0])


def test_a_memory_that_is_handed_on_continues_with_the_same_results() -> None:
    _, _, pieces = Pieces().after(seen(WALL))
    weights, _, after = pieces.after(seen(WALL + 0.3))
    again, _, same = Pieces(bytes(pieces.rows)).after(seen(WALL + 0.3))
    np.testing.assert_array_equal(again, weights)
    assert same == after


def test_the_memory_is_bounded_and_forgets_what_is_far() -> None:
    pieces = Pieces()
    line = np.column_stack((np.arange(600) * PIECE_M, np.zeros(600)))
    for row in range(5):
        far = line + np.array([0.0, 100.0 * row])
        _, _, pieces = pieces.after(np.concatenate((far[:1], far)))
        assert pieces.problem is None
    assert len(pieces.rows) == 16 * MAX_PIECES
    forgotten, _, _ = pieces.after(np.concatenate((line[:1], line)))
    assert forgotten.sum() == pytest.approx(len(line) / (1.0 + DOUBTFUL)), "new once more"


@hypothesis.given(
    st.lists(
        arrays(np.float64, (7, 2), elements=st.floats() | st.floats(-100.0, 100.0)),
        max_size=4,
    )
)
def test_any_ends_give_shares(scans: list[np.ndarray]) -> None:
    pieces = Pieces()
    for scan in scans:
        weights, share, pieces = pieces.after(scan)
        assert len(weights) == 6
        assert ((weights >= 0.0) & (weights <= 1.0)).all()
        assert 0.0 <= share <= 1.0 + 1e-9
        assert pieces.problem is None
    assert math.isfinite(len(pieces.rows))


@pytest.mark.parametrize(
    "rows",
    [b"x", bytes(16 * (MAX_PIECES + 1)), np.full(4, np.nan, "<f4").tobytes(), b"\xff" * 16],
)
def test_an_impossible_memory_has_a_problem(rows: bytes) -> None:
    assert Pieces(rows).problem is not None
    assert Pieces(bytes(16)).problem is None
