from math import cos, pi, sin

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from clustermcl.filter.arrays import Pose, Poses
from clustermcl.filter.poses import between, compose, heading_distance, inverse, wrap_angle
from tests.unit.filter import naive

angles = st.floats(-1e4, 1e4)
pose = arrays(np.float64, 3, elements=st.floats(-100, 100))
poses = arrays(np.float64, (5, 3), elements=st.floats(-100, 100))


def assert_same_place(a: Poses, b: Poses) -> None:
    """Equal up to rounding of numbers of size 100; headings of -pi and pi are the same."""
    np.testing.assert_allclose(a[..., :2], b[..., :2], atol=1e-10)
    np.testing.assert_allclose(heading_distance(a[..., 2], b[..., 2]), 0.0, atol=1e-10)


@given(angle=angles)
def test_a_wrapped_angle_points_the_same_way_and_is_in_range(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -pi <= wrapped < pi
    assert abs(sin(wrapped) - sin(angle)) < 1e-11  # 1e4 has an absolute precision of 1e-12
    assert abs(cos(wrapped) - cos(angle)) < 1e-11


@given(angle=st.floats(-pi, np.nextafter(pi, 0.0)))
def test_an_angle_in_range_is_left_exactly_as_it_is(angle: float) -> None:
    assert wrap_angle(angle) == angle


@pytest.mark.parametrize("turns", range(-3, 4))
@pytest.mark.parametrize("ulps", [-1, 0, 1])
def test_angles_at_the_seam_stay_in_range(turns: int, ulps: int) -> None:
    seam = (2 * turns + 1) * pi
    angle = float(np.nextafter(seam, seam + ulps)) if ulps else seam
    assert -pi <= wrap_angle(angle) < pi
    assert -pi <= wrap_angle(np.array([angle]))[0] < pi


@given(a=pose, b=pose)
def test_composing_a_pose_with_the_motion_between_gives_the_other_pose(a: Pose, b: Pose) -> None:
    assert_same_place(compose(a, between(a, b)), b)


@given(a=pose, b=pose)
def test_composing_multiplies_matrices(a: Pose, b: Pose) -> None:
    np.testing.assert_allclose(
        naive.matrix(compose(a, b)), naive.matrix(a) @ naive.matrix(b), atol=1e-10
    )


@given(many=poses, one=pose)
def test_one_pose_and_many_poses_broadcast(many: Poses, one: Pose) -> None:
    for combine in (compose, between):
        np.testing.assert_array_equal(
            combine(one, many), np.array([combine(one, other) for other in many])
        )
        np.testing.assert_array_equal(
            combine(many, one), np.array([combine(other, one) for other in many])
        )
    np.testing.assert_array_equal(inverse(many), np.array([inverse(other) for other in many]))


@given(a=pose)
def test_a_pose_and_its_inverse_cancel_out(a: Pose) -> None:
    assert_same_place(compose(a, inverse(a)), np.zeros(3))
    assert_same_place(inverse(a), between(a, np.zeros(3)))
