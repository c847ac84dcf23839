import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.evaluation.pose_error import pose_error
from clustermcl.protocol.message import PoseTuple

TRUTH: PoseTuple = (10.0, 5.0, 3.0)


@pytest.mark.parametrize(
    ("pose", "right"),
    [
        ((10.99, 5.0, 3.0), True),
        ((11.01, 5.0, 3.0), False),
        ((10.0, 5.0, 3.0 + math.radians(19.9) - math.tau), True),
        ((10.0, 5.0, 3.0 + math.radians(20.1)), False),
    ],
)
def test_right_is_within_a_metre_and_twenty_degrees(pose: PoseTuple, right: bool) -> None:
    assert pose_error(pose, TRUTH).right is right


@given(st.tuples(*[st.floats(-50, 50)] * 3), st.tuples(*[st.floats(-50, 50)] * 3))
def test_errors_are_symmetric_and_never_more_than_half_a_turn(a: PoseTuple, b: PoseTuple) -> None:
    there, back = pose_error(a, b), pose_error(b, a)
    assert there.distance_m == back.distance_m >= 0.0
    assert there.heading_rad == pytest.approx(back.heading_rad, abs=1e-9)
    assert 0.0 <= there.heading_rad <= math.pi
