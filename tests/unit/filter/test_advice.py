import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from clustermcl.filter.advice.advice import (
    LEAST_INFORMATION,
    Question,
    Way,
    advised_ways,
    expected_gains,
)
from clustermcl.filter.advice.roads import MARGIN_M, roads_of
from clustermcl.filter.advice.view_memory import ViewMemory
from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN, Cells, Pose
from clustermcl.filter.grid import Grid
from clustermcl.filter.poses import compose
from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.pose_arrays import pose_tuple
from tests.unit.filter.rooms import ANGLES, CELL_M, model_of, scan_of

RADIUS_M = 0.2
KNOWN = np.diag([0.03, 0.03, 0.01]) ** 2
RIGHT, LEFT = (2.0, 2.0, 0.0), (12.0, 2.0, 0.0)


def two_flats(*, cupboard: bool) -> Cells:
    """Two equal flats of two rooms with a door between; a cupboard in the far room of one."""
    flat = np.full((80, 200), OCCUPIED, np.int8)
    flat[3:77, 3:97] = FREE
    flat[3:77, 103:197] = FREE
    flat[30:50, 97:103] = FREE  # a door of 1 m
    other = flat.copy()
    if cupboard:
        other[55:70, 150:175] = OCCUPIED
    return np.concatenate([flat, other], axis=1)


def seen_at(*poses: Sequence[float] | Pose) -> ViewMemory:
    rows = [(x, y, heading, 1.0) for x, y, heading in poses]
    return ViewMemory(np.array(rows, "<f4").tobytes())


def question(*places: tuple[float, float, float]) -> Question:
    laser = scan_of(np.ones(len(ANGLES)), 8.0)
    count = len(places)
    return Question(
        np.array(places), np.array([KNOWN] * count), np.full(count, 1.0 / count), laser,
        RADIUS_M, ViewMemory(), 0.2, 0.2,
    )  # fmt: skip


def ways_in(cells: Cells, asked: Question) -> list[Way]:
    return advised_ways(asked, model_of(cells), FilterSettings())[0]


FLATS = two_flats(cupboard=True)
ASKED = question(RIGHT, LEFT)


def test_the_first_ways_end_where_the_cupboard_is_seen() -> None:
    ways = ways_in(FLATS, ASKED)
    assert ways
    for way in ways:
        x, y, _ = way.poses[-1] + (2.0, 2.0, 0.0)
        assert x > 4.5  # at or behind the door; from the first room, nothing differs
        assert 0.0 < y < 4.0
    assert ways[0].information > LEAST_INFORMATION
    assert ways[0].length_m == pytest.approx(
        np.hypot(*np.diff(ways[0].poses[:, :2], axis=0).T).sum()
    )


def test_spots_tell_more_where_the_cupboard_is_seen() -> None:
    _, spots = advised_ways(ASKED, model_of(FLATS), FilterSettings())
    behind = spots[:, 0] > 3.5
    assert spots[behind, 2].max() > LEAST_INFORMATION
    assert spots[behind, 2].max() > 3.0 * spots[spots[:, 0] < 0.0, 2].max()
    assert np.all((spots[:, 2] >= 0.0) & (spots[:, 2] <= math.log(2.0) + 1e-9))


@pytest.mark.parametrize(("x_m", "is_advised"), [(0.0, True), (5.5, False)])
def test_a_cupboard_that_was_not_seen_is_not_looked_for_again(x_m: float, is_advised: bool) -> None:
    """Only the flat with a cupboard would have gained evidence in the far room."""
    asked = replace(ASKED, seen=seen_at((x_m, 0.3, 0.0)))
    assert bool(ways_in(FLATS, asked)) == is_advised


def test_a_place_is_confirmed_after_another_was_not_seen() -> None:
    """The belief keeps both places equal: its evidence is only what each would have seen."""
    cells = FLATS.copy()
    cells[55:70, 50:75] = OCCUPIED  # in the near room of the first flat
    ways = ways_in(cells, replace(ASKED, seen=seen_at((0.0, 0.3, 0.0))))
    assert ways[0].poses[-1, 0] + 2.0 > 4.5  # to the cupboard in the far room of the second
    assert ways[0].gains[1] > 3.0 * LEAST_INFORMATION


@pytest.mark.parametrize(("x_m", "stands"), [(9.85, False), (9.75, False), (10.3, True)])
def test_no_way_begins_where_the_robot_cannot_stand(x_m: float, stands: bool) -> None:
    """The second flat begins behind a wall from 9.85 m to 10.15 m."""
    ways, spots = advised_ways(question(RIGHT, (x_m, 2.0, 0.0)), model_of(FLATS), FilterSettings())
    assert (np.hypot(*spots[:, :2].T).max() > 1.0) == stands
    assert stands or all(np.ptp(way.poses[:, :2]) == 0.0 for way in ways)


def test_no_way_distinguishes_equal_flats() -> None:
    ways, spots = advised_ways(ASKED, model_of(two_flats(cupboard=False)), FilterSettings())
    assert ways == []
    assert np.hypot(*spots[:, :2].T).max() > 5.0
    assert np.all(spots[:, 2] < 0.01)


def clearance_m(way: Way, place: Pose, cells: Cells) -> float:
    """Between the way, begun at a place, and the middle of the nearest obstacle's cell."""
    shares = np.linspace(0.0, 1.0, 5)[:, None, None]
    points = ((1.0 - shares) * way.poses[:-1, :2] + shares * way.poses[1:, :2]).reshape(-1, 2)
    in_map = compose(place, np.insert(points, 2, 0.0, axis=1))
    obstacles = (np.argwhere(cells != FREE)[:, ::-1] + 0.5) * CELL_M
    return float(cKDTree(obstacles).query(in_map[:, :2])[0].min())


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.0), (0.13, -0.31, 1.1), (-0.4, 0.62, -2.2)])
def test_no_way_comes_near_a_wall_at_any_place(off: tuple[float, float, float]) -> None:
    places = [compose(np.array(place), np.array(off)) for place in (RIGHT, LEFT)]
    cells = FLATS.copy()
    cells[10:20, 240:250] = OCCUPIED  # a box that is in the way at the second place only
    cells[60:70, 60:70] = UNKNOWN
    ways = ways_in(cells, question(*(pose_tuple(place) for place in places)))
    assert sum(len(way.poses) - 1 for way in ways) > 15
    for way in ways:
        for place in places:
            nearest = clearance_m(way, place, cells) - 0.5 * CELL_M * math.sqrt(2.0)
            assert nearest >= RADIUS_M + MARGIN_M - 0.02


def test_a_way_stays_clear_if_a_place_is_off_by_its_standard_deviation() -> None:
    heading_rad = 0.15
    known = np.array([np.diag([0.02, 0.02, heading_rad]) ** 2] * 2)
    ways = ways_in(FLATS, replace(ASKED, covariances=known))
    assert all(len(way.poses) > 1 for way in ways), "else it leads nowhere"
    assert any(len(way.rest) for way in ways)  # the door is too far away for such a heading
    for way in ways:
        for off in (-heading_rad, 0.0, heading_rad):
            assert clearance_m(way, np.array([*RIGHT[:2], off]), FLATS) >= RADIUS_M


def test_in_a_closed_room_ways_are_shorter_than_half_a_metre() -> None:
    cells = np.full((200, 200), OCCUPIED, np.int8)
    cells[94:106, 94:106] = FREE
    _, spots = advised_ways(
        question((5.0, 5.0, 0.0), (5.0, 5.0, 1.5)), model_of(cells), FilterSettings()
    )
    assert np.hypot(*spots[:, :2].T).max() < 0.5


@pytest.mark.parametrize(("shape", "place"), [((7, 200), (10.0, 0.35, 0.0)),
                                             ((200, 7), (0.35, 10.0, math.pi / 2))])  # fmt: skip
def test_a_map_is_free_up_to_its_border(
    shape: tuple[int, int], place: tuple[float, float, float]
) -> None:
    """A corridor of 0.7 m, in which a robot keeps 0.35 m on both sides and needs 0.3 m."""
    grid = Grid(np.full(shape, FREE, np.int8), 0.1, np.zeros(3))
    roads = roads_of(np.array([place]), np.zeros((1, 3, 3)), RADIUS_M, grid)
    assert np.ptp(roads.nodes[roads.spots, 0]) > 15.0


def test_places_outside_of_the_map_have_no_way() -> None:
    asked = question((500.0, 2.0, 0.0), (-500.0, 2.0, 0.0))
    assert ways_in(FLATS, asked) == []


@given(
    shares=st.lists(st.floats(1e-6, 1.0), min_size=2, max_size=6),
    size=st.floats(0.0, 500.0),
    total=st.floats(0.1, 1.0),
)
def test_information_is_between_none_and_the_entropy(
    shares: list[float], size: float, total: float
) -> None:
    prior = np.array(shares) / math.fsum(shares)
    evidence = size * (1.0 - np.eye(len(prior)))
    gains, sure = expected_gains(total * prior, evidence, 0.9)
    information = prior @ gains
    entropy = float(-(prior * np.log(prior)).sum())
    assert -1e-9 <= information <= entropy + 1e-9
    assert ((sure >= 0.0) & (sure <= 1.0)).all()
    if size == 500.0:
        assert information == pytest.approx(entropy)
        assert sure == pytest.approx(1.0)
    if size == 0.0:
        assert information == pytest.approx(0.0, abs=1e-9)


def test_information_equals_that_of_a_certain_answer() -> None:
    """One of four places differs from the other three, which are alike."""
    evidence = np.zeros((4, 4))
    evidence[0, 1:] = evidence[1:, 0] = 1e4
    gains, sure = expected_gains(np.full(4, 0.25), evidence, 0.9)
    assert gains == pytest.approx([math.log(4.0)] + 3 * [math.log(4.0 / 3.0)])
    assert sure == pytest.approx([1.0, 0.0, 0.0, 0.0])
