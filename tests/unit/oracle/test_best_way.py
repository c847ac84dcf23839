import math
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise, product

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from clustermcl.filter.advice.advice import EVIDENCE_NOISE, Question, advised_ways
from clustermcl.filter.advice.view_memory import ViewMemory
from clustermcl.filter.arrays import FREE, OCCUPIED, Cells
from clustermcl.filter.laser.evidence_model import VIEW_M, VIEW_RAD
from clustermcl.filter.poses import wrap_angle
from clustermcl.filter.settings import FilterSettings
from tests.unit.filter.naive_rays import cast_rays
from tests.unit.filter.rooms import ANGLES, CELL_M, model_of, scan_of

MOVE_M, MOVES = 0.7, 6
RADIUS_M, MARGIN_M, RANGE_M = 0.2, 0.1, 8.0
GATE = 0.2
"""Distance [m] and turn [rad] between two steps."""
OFF_M, OFF_RAD = (-0.075, 0.0, 0.075), (-0.03, 0.0, 0.03)
"""Poses are known no better."""
PLACES = np.array([[1.0, 1.0, 0.0], [7.0, 1.0, 0.0]])


def two_rooms() -> Cells:
    """Two rooms of 5.7 m x 3.7 m with a wall across; a cupboard behind the wall of one."""
    room = np.full((80, 120), OCCUPIED, np.int8)
    room[3:77, 3:117] = FREE
    room[:48, 58:62] = OCCUPIED
    other = room.copy()
    other[8:24, 62:80] = OCCUPIED
    return np.concatenate([room, other], axis=1)


CELLS = two_rooms()
MODEL = model_of(CELLS)
BLOCKED = (np.argwhere(CELLS != FREE)[:, ::-1] + 0.5) * CELL_M


@cache
def is_free(point: tuple[float, float]) -> bool:
    """Whether the robot fits at both places."""
    there = PLACES[:, None, :2] + point
    return bool(np.hypot(*(BLOCKED - there).T).min() > RADIUS_M + MARGIN_M + 0.5 * CELL_M)


@cache
def counted(point: tuple[float, float]) -> NDArray[np.float64]:
    """Return (2,) the counted evidence of an ideal scan at each place against the other."""
    seen_from = PLACES + np.array((*point, 0.0))
    grid = np.meshgrid(OFF_M, OFF_M, OFF_RAD)
    poses = (seen_from[:, None] + np.stack(grid, axis=-1).reshape(-1, 3)).reshape(-1, 3)
    against = np.zeros(2)
    for right in (0, 1):
        ranges = cast_rays(CELLS, CELL_M, seen_from[right], ANGLES, RANGE_M)
        beams = MODEL.beams(scan_of(ranges, RANGE_M))
        fits = MODEL.log_likelihood(poses, beams).reshape(2, -1).max(axis=1)
        exponent = MODEL.settings.scan_likelihood_exponent
        nats = max(exponent * float(fits[right] - fits[1 - right]), 0.0)
        against[right] = nats**2 / (nats + EVIDENCE_NOISE)
    return against


def rate(points: Sequence[tuple[float, float]]) -> float:
    """Return how much a way that begins at the robot is worth for its length."""
    total, length, turned, heading = np.zeros(2), 0.0, 0.0, 0.0
    for (x, y), (to_x, to_y) in pairwise(points):
        metres, direction = math.hypot(to_x - x, to_y - y), math.atan2(to_y - y, to_x - x)
        radians = abs(wrap_angle(direction - heading))
        length, turned, heading = length + metres, turned + radians, direction
        new = metres * -math.expm1(-GATE / VIEW_M) / GATE
        new += radians * -math.expm1(-GATE / VIEW_RAD) / GATE
        total += new * counted((round(to_x, 2), round(to_y, 2)))
    gains = 1.0 - np.log1p(np.exp(-total)) / math.log(2.0)
    # The log-likelihood ratio is normal, with twice its mean as variance.
    sure = norm.cdf(total - math.log(9.0), scale=np.sqrt(2.0 * total) + 1e-9)
    return float((gains + sure).mean()) / (length + 0.3 * turned + 5.0)


def all_ways(way: list[tuple[float, float]]) -> Iterator[list[tuple[float, float]]]:
    """Yield all ways of at most `MOVES` moves that do not return to a point."""
    yield way
    x, y = way[-1]
    for right, up in product((-MOVE_M, 0.0, MOVE_M), repeat=2):
        after = (round(x + right, 2), round(y + up, 2))
        halfway = (round(x + right / 2, 2), round(y + up / 2, 2))
        if len(way) <= MOVES and after not in way and is_free(after) and is_free(halfway):
            yield from all_ways([*way, after])


def test_the_first_three_have_the_best_of_all_short_ways() -> None:
    laser = scan_of(np.ones(len(ANGLES)), RANGE_M)
    known = np.diag([0.05, 0.05, 0.02]) ** 2
    question = Question(
        PLACES, np.array([known, known]), np.full(2, 0.5), laser, RADIUS_M, ViewMemory(),
        GATE, GATE,
    )  # fmt: skip
    ways, _ = advised_ways(question, MODEL, FilterSettings())
    best = max(all_ways([(0.0, 0.0)]), key=rate)
    assert rate(best) > 0.02
    points = [np.concatenate([way.poses, way.rest])[:, :2].tolist() for way in ways[:3]]
    assert max(map(rate, points)) > 0.9 * rate(best)
    assert min(math.dist(way[-1], best[-1]) for way in points) < 2.0 * MOVE_M
