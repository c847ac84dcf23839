import numpy as np
import pytest

from clustermcl.filter.arrays import FREE, OCCUPIED
from clustermcl.filter.laser.seen_cells import WATCHED, Codes, codes_of, seen_cells

GROUND = np.full((20, 20), FREE, np.int8)
WALL = GROUND.copy()
WALL[:, 6] = OCCUPIED
LASER = np.array([2.5, 10.5, 0.0])
"""In cells of one metre, looking along its row."""
AROUND = {(row, col) for row in (9, 10, 11) for col in (7, 8, 9)}


def news_of(codes: Codes, *ranges: float, reach: float = 15.0) -> dict[tuple[int, int], bool]:
    """Row and column of the cells that equal beams contradict, and whether they are occupied."""
    seen, out, kept = np.zeros(codes.shape, np.int32), np.zeros((99, 2), np.int32), codes.copy()
    one_metre = (1.0, 0.0, 0.0, 0.0)
    beams = np.array(ranges), 0.0, 0.0, 12.0
    count = seen_cells(codes, seen, 7, one_metre, LASER, *beams, reach, 3.0, out)
    np.testing.assert_array_equal(codes, kept, "no mark is left")
    assert set(seen.ravel().tolist()) <= {0, 7}
    return {divmod(cell, codes.shape[1]): bool(is_occupied) for cell, is_occupied in out[:count]}


@pytest.mark.parametrize(("reach", "passed"), [(15.0, (3, 4, 5, 6)), (3.0, (3, 4))])
def test_a_beam_passes_cells_up_to_the_reach_and_not_those_next_to_its_end(
    reach: float, passed: tuple[int, ...]
) -> None:
    found = news_of(codes_of(GROUND) | np.uint16(WATCHED), 6.0, reach=reach)
    assert {cell for cell, is_occupied in found.items() if not is_occupied} == {
        (10, col) for col in passed
    }
    assert {cell for cell, is_occupied in found.items() if is_occupied} == (
        AROUND if reach > 6.0 else set()
    )


def test_only_what_contradicts_the_map_is_news_where_nothing_is_watched() -> None:
    assert news_of(codes_of(GROUND), 6.0) == {(10, 8): True}
    for beams in (1, 31, 64):
        assert news_of(codes_of(WALL), *[9.0] * beams) == {(10, 11): True, (10, 6): False}
    assert news_of(codes_of(WALL), 6.0) == {}, "it ends too little behind the wall to be sure"
    assert news_of(codes_of(GROUND), 13.0, -1.0, np.nan) == {}


def test_a_cell_is_occupied_if_as_many_beams_end_there_as_pass_it() -> None:
    assert news_of(codes_of(GROUND), 4.0, 9.0) == {(10, 6): True, (10, 11): True}
    assert news_of(codes_of(GROUND), 4.0, 9.0, 9.0) == {(10, 11): True}


def test_a_cell_at_or_next_to_an_end_is_free_only_if_many_beams_pass_it() -> None:
    watched, beyond = codes_of(GROUND) | np.uint16(WATCHED), 11.0
    two, three, four = (news_of(watched, 6.0, *[beyond] * count) for count in (2, 3, 4))
    assert (two[10, 7], three[10, 7]) == (True, False)
    assert (10, 8) not in three, "it is open"
    assert not four[10, 8]
