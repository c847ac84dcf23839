import math

import hypothesis
import msgspec
import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from msgspec.structs import replace

from clustermcl.filter.laser.pieces import BEFORE_M, DOUBTFUL, MAX_PIECES, PIECE_M, Pieces
from clustermcl.filter.poses import compose

WALL = np.array([[3.1, 0.1], [3.2, 0.2]])
"""Two ends in one piece."""


def after(
    pieces: Pieces, ends: np.ndarray, robot: tuple[float, float, float] = (0.1, 0.1, 0.0)
) -> tuple[np.ndarray, float, Pieces]:
    """Of a robot here, in the frame of the pieces, that sees these ends in the same frame."""
    x, y, heading = robot
    c, s = math.cos(heading), math.sin(heading)
    in_robot = (ends - (x, y)) @ np.array([[c, -s], [s, c]])
    return replace(pieces, robot=robot).after(in_robot)


def test_a_piece_of_wall_counts_once_however_long_the_robot_looks_at_it() -> None:
    pieces, total = Pieces(), 0.0
    for scans in range(1, 200):
        weights, share, pieces = after(pieces, WALL)
        total += weights.sum()
        assert share == pytest.approx(weights.sum() / (2 / (2 + DOUBTFUL))), "of all that is seen"
        assert weights[0] == weights[1]
        assert total == pytest.approx(2 * scans / (2 * scans + DOUBTFUL))
    assert pieces.problem is None


def test_other_pieces_count_in_full() -> None:
    first, _, pieces = after(Pieces(), WALL)
    again, _, _ = after(pieces, WALL + np.array([0.0, PIECE_M]), (0.1, 0.1 + PIECE_M, 0.0))
    assert again == pytest.approx(first)


@pytest.mark.parametrize("moves", [[(0.0, 0.0, 2.0)], [(1.5, 0.0, -0.7), (-0.3, 0.4, 1.0)]])
def test_a_robot_that_has_moved_sees_the_same_pieces(
    moves: list[tuple[float, float, float]],
) -> None:
    _, _, pieces = after(Pieces(), WALL)
    pose = np.array(pieces.robot)
    for move in moves:
        pieces, pose = pieces.moved(np.array(move)), compose(pose, np.array(move))
    assert pieces.robot == pytest.approx(tuple(pose))
    stays, _, _ = after(pieces, WALL)
    moved, _, _ = after(pieces, WALL, pieces.robot)
    assert moved == pytest.approx(stays)


def test_a_robot_too_far_away_begins_anew() -> None:
    """The motion is from reports, which may be of any size."""
    _, _, pieces = after(Pieces(), WALL)
    for _ in range(2_000):
        pieces = pieces.moved(np.array([1e6, 0.0, 0.0]))
        _, _, pieces = pieces.after(WALL)
        assert pieces.problem is None
        assert msgspec.json.decode(msgspec.json.encode(pieces), type=Pieces) == pieces
    assert len(pieces.rows) < 16 * 2_000


def test_what_later_beams_pass_was_no_wall() -> None:
    _, _, pieces = after(Pieces(), WALL)
    for _ in range(5):
        _, _, pieces = after(pieces, np.array([[8.1, 0.1]]))
    weights, _, _ = after(pieces, WALL)
    assert weights.sum() == pytest.approx(4 / (4 + 5 + DOUBTFUL) - 2 / (2 + 5 + DOUBTFUL))


def test_a_beam_passes_the_pieces_in_front_of_the_robot_but_not_those_near_its_end() -> None:
    along = np.arange(-3, 30) * PIECE_M + 0.1
    line, below = np.column_stack((along, np.full(len(along), 0.1))), (5.1, -40.1, 0.0)
    _, _, pieces = after(Pieces(), line, below)
    without, _, _ = after(pieces, line, below)
    _, _, pieces = after(pieces, np.array([[9.1, 0.1]]))
    weights, _, _ = after(pieces, line, below)
    passed = (along > 0.1 + 1e-9) & (along <= 9.1 - BEFORE_M)
    np.testing.assert_array_equal(weights[along < 9.0] < without[along < 9.0], passed[along < 9.0])


def test_the_memory_is_bounded_and_forgets_what_is_far() -> None:
    pieces = Pieces()
    line = np.column_stack((np.arange(600) * PIECE_M, np.zeros(600)))
    for row in range(5):
        far = line + np.array([0.0, 100.0 * row])
        _, _, pieces = after(pieces, far, (*far[0], 0.0))
        assert pieces.problem is None
    assert len(pieces.rows) == 16 * MAX_PIECES
    forgotten, _, _ = after(pieces, line, (0.0, 0.0, 0.0))
    assert forgotten.sum() == pytest.approx(len(line) / (1.0 + DOUBTFUL)), "new once more"


@hypothesis.given(
    st.lists(
        arrays(np.float64, (7, 2), elements=st.floats() | st.floats(-100.0, 100.0)), max_size=4
    )
)
def test_any_ends_give_shares(scans: list[np.ndarray]) -> None:
    pieces = Pieces()
    for scan in scans:
        weights, share, pieces = pieces.after(scan)
        assert len(weights) == 7
        assert ((weights >= 0.0) & (weights <= 1.0)).all()
        assert 0.0 <= share <= 1.0 + 1e-9
        assert pieces.problem is None
    assert math.isfinite(len(pieces.rows))


@pytest.mark.parametrize(
    "rows", [b"x", bytes(16 * (MAX_PIECES + 1)), np.full(4, np.nan, "<f4").tobytes(), b"\xff" * 16]
)
def test_an_impossible_memory_has_a_problem(rows: bytes) -> None:
    assert Pieces(rows).problem is not None
    assert Pieces(bytes(16)).problem is None
