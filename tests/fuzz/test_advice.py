"""Questions for advice that the protocol allows are answered, by an answer that can be sent."""

import math
from functools import cache

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace
from numpy.typing import NDArray

from clustermcl.filter.arrays import FREE, OCCUPIED, UNKNOWN
from clustermcl.filter.grid import Grid
from clustermcl.filter.laser.sensor_model import SensorModel, computed_model
from clustermcl.filter.settings import FilterSettings
from clustermcl.jobs.advising import advice
from clustermcl.protocol.advice import Advice, AdviceQuestion
from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.validity import problem_of
from tests.fuzz.effort import cases
from tests.unit.evaluation.places import place
from tests.unit.worker.test_advising import SCAN

FILTER = FilterSettings()
NUMBERS = st.floats(-1e6, 1e6) | st.floats(-4.0, 4.0)
VARIANCES = st.floats(0.0, 1e6) | st.floats(0.0, 0.1)
POSES = st.tuples(NUMBERS, NUMBERS, NUMBERS)


@cache
def room() -> SensorModel:
    """A room of 4 m around the origin, with a box and unknown ground."""
    cells = np.full((90, 90), OCCUPIED, np.int8)
    cells[5:85, 5:85] = FREE
    cells[60:70, 60:70] = OCCUPIED
    cells[10:20, 60:80] = UNKNOWN
    return computed_model(Grid(cells, 0.05, np.array([-2.25, -2.25, 0.0])), FILTER.sensor)


@st.composite
def questions(draw: st.DrawFn) -> AdviceQuestion:
    places = []
    for cluster in range(draw(st.integers(0, 4))):
        xx, yy, hh = draw(st.tuples(VARIANCES, VARIANCES, VARIANCES))
        xy = draw(NUMBERS)
        covariance = (xx, xy, 0.0, xy, yy, 0.0, 0.0, 0.0, hh)
        probability, pose = draw(st.floats(0.0, 1.0)), draw(POSES)
        places.append(place(probability, pose, cluster=cluster, covariance=covariance))
    views = draw(st.lists(st.tuples(NUMBERS, NUMBERS, NUMBERS, st.floats(0.0, 1.0)), max_size=5))
    rows = np.array(views, "<f4").reshape(-1, 4)
    return AdviceQuestion(
        sender="test", step=SCAN.step, map_digest=SCAN.map_digest, hypotheses=tuple(places),
        elsewhere_probability=draw(st.floats(0.0, 1.0)), radius_m=draw(st.floats(0.0, 10.0)),
        views=rows.tobytes(), gate_distance_m=draw(st.floats(0.0, 10.0)),
        gate_turn_rad=draw(st.floats(0.0, 10.0)),
    )  # fmt: skip


RANGES = st.lists(st.floats(width=32) | st.just(math.nan), min_size=181, max_size=181)


@cases(0.005)
@given(asked=questions(), ranges=st.none() | RANGES.map(np.array))
def test_every_allowed_question_gets_an_answer_that_can_be_sent(
    asked: AdviceQuestion, ranges: NDArray[np.float64] | None
) -> None:
    scan = SCAN
    if ranges is not None:
        scan = replace(scan, ranges=ArrayBlob.of(ranges.astype("<f4"), "float32"))
    if problem_of(asked) is not None:
        return
    answer = advice(asked, scan, room(), FILTER, "worker-0")
    sent = decode(encode(answer), Advice)
    assert len(sent.ways) <= 6
    for way in sent.ways:
        assert way.poses[0][:2] == (0.0, 0.0)
        assert 0.0 <= way.sure_probability <= 1.0
        assert len(way.gains) == len(asked.hypotheses)
    assert sent.ways or sent.note
