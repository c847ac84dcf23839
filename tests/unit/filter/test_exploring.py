"""Ways to unseen ground: free by the scan, away from earlier views."""

import math

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from clustermcl.filter.advice.exploring import LEAST_M, MOST_M, unseen_way
from clustermcl.filter.advice.roads import MARGIN_M, roads_of
from clustermcl.filter.cluster.view_memory import ViewMemory
from clustermcl.filter.laser.sensor_model import LaserScan
from clustermcl.filter.poses import compose
from tests.unit.filter.rooms import scan_of
from tests.unit.filter.test_advice import FLATS, KNOWN, LEFT, model_of, seen_at

RADIUS_M = 0.25
ANGLES = np.linspace(-math.pi, math.pi, 180, endpoint=False)


def scan(ranges: NDArray[np.float64]) -> LaserScan:
    return scan_of(ranges, 12.0, ANGLES)


def in_corridor(ahead_m: float, behind_m: float) -> LaserScan:
    """The scan in a corridor of 2 m along x."""
    c, s = np.cos(ANGLES), np.sin(ANGLES)
    to_ends = np.where(c > 0.0, ahead_m, behind_m) / np.maximum(np.abs(c), 1e-9)
    return scan(np.minimum(to_ends, 1.0 / np.maximum(np.abs(s), 1e-9)))


def test_the_longest_free_way_is_taken_before_anything_was_seen() -> None:
    way = unseen_way(in_corridor(9.0, 4.0), ViewMemory(), RADIUS_M, None)
    assert 8.0 < way[-1, 0] <= 9.0 - RADIUS_M - MARGIN_M + 1e-9
    assert abs(way[-1, 1]) < 1.0
    np.testing.assert_allclose(np.hypot(*np.diff(way[:, :2], axis=0).T), 0.2)


def test_seen_ground_is_left_for_unseen_ground() -> None:
    seen = seen_at(*((float(x), 0.0, 0.0) for x in range(10)))
    way = unseen_way(in_corridor(9.0, 4.0), seen, RADIUS_M, None)
    assert -4.0 + RADIUS_M + MARGIN_M <= way[-1, 0] < -3.0
    assert abs(way[-1, 2]) > math.radians(160.0)


def test_no_way_leads_where_nothing_was_hit_or_where_there_is_no_room() -> None:
    for ranges in (np.full(180, math.inf), np.full(180, math.nan), np.full(180, 1.0)):
        assert unseen_way(scan(ranges), ViewMemory(), RADIUS_M, None).shape == (0, 3)


def test_the_way_is_also_free_at_the_possible_places() -> None:
    place = np.array([LEFT])
    roads = roads_of(place, KNOWN[None], RADIUS_M, model_of(FLATS).grid)
    free = unseen_way(scan(np.full(180, 9.0)), ViewMemory(), RADIUS_M, None)
    assert np.hypot(*free[-1, :2]) > 8.0
    way = unseen_way(scan(np.full(180, 9.0)), ViewMemory(), RADIUS_M, roads)
    assert LEAST_M <= np.hypot(*way[-1, :2]) < np.hypot(*free[-1, :2]) - 0.5
    in_map = compose(place[0], way)
    cells = np.floor(in_map[:, 1::-1] / 0.05).astype(int)
    assert np.all(FLATS[cells[:, 0], cells[:, 1]] == 0)


BESIDE = np.full(180, 3.0)
BESIDE[[165, 74]] = 0.5, 1.0
"""A hit exactly beside the way that the others leave free."""


@example(ranges=BESIDE, views=[], radius_m=1.0)
@given(
    ranges=arrays(np.float64, 180, elements=st.floats(-1.0, 15.0) | st.just(math.nan)),
    views=st.lists(st.tuples(*[st.floats(-20.0, 20.0)] * 3), max_size=8),
    radius_m=st.floats(0.0, 10.0),
)
def test_no_hit_is_nearer_to_the_way_than_the_radius(
    ranges: NDArray[np.float64], views: list[tuple[float, float, float]], radius_m: float
) -> None:
    way = unseen_way(scan(ranges), seen_at(*views), radius_m, None)
    hit = (ranges > 0.0) & (ranges < 12.0)
    hits = np.stack([ranges * np.cos(ANGLES), ranges * np.sin(ANGLES)], axis=-1)[hit]
    if len(way) == 0:
        return
    assert LEAST_M - 1e-9 <= np.hypot(*way[-1, :2]) <= MOST_M + 1e-9
    bearing = way[-1, 2]
    ahead = hits @ (math.cos(bearing), math.sin(bearing)) > 0.0  # the robot stands free already
    assert np.hypot(*(hits[ahead, None] - way[1:, :2]).T).min() >= radius_m
