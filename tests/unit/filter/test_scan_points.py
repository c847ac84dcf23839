import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from clustermcl.filter.laser.sensor_model import Beams, usable_beams
from clustermcl.filter.poses import compose

readings = st.one_of(
    st.floats(0.01, 9.99), st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 10.0, 81.9])
)
scans = st.lists(readings, max_size=50).map(np.array)


@given(ranges=scans, max_beams=st.integers(1, 60))
def test_only_valid_beams_are_used_up_to_the_limit(
    ranges: NDArray[np.float64], max_beams: int
) -> None:
    valid = {i for i, r in enumerate(ranges) if 0 < r < 10.0}  # false for NaN
    chosen = usable_beams(ranges, 10.0, max_beams)
    assert set(chosen.tolist()) <= valid
    assert len(chosen) == min(len(valid), max_beams)
    assert (np.diff(chosen) > 0).all()


@given(count=st.integers(1, 400), max_beams=st.integers(1, 400))
def test_valid_beams_are_thinned_evenly(count: int, max_beams: int) -> None:
    chosen = usable_beams(np.ones(count), 10.0, max_beams)
    steps = np.diff(chosen)
    assert len(steps) == 0 or steps.max() - steps.min() <= 1
    if count > max_beams:  # the same margin at both ends, up to one beam
        assert abs(int(chosen[0]) - (count - 1 - int(chosen[-1]))) <= 1


def test_single_precision_ranges_are_accepted() -> None:
    assert usable_beams(np.array([1.0, np.nan], np.float32), 10.0, 9).tolist() == [0]


def test_at_least_one_beam_must_be_allowed() -> None:
    with pytest.raises(ValueError, match="max_beams"):
        usable_beams(np.ones(3), 10.0, 0)


@given(angle_min=st.floats(-4, 4), x=st.floats(-1, 1), y=st.floats(-1, 1), turn=st.floats(-4, 4))
def test_points_are_the_laser_pose_composed_with_the_beam(
    angle_min: float, x: float, y: float, turn: float
) -> None:
    laser, ranges = np.array([x, y, turn]), np.array([0.5, 7.0, 2.0])
    points = Beams(ranges, angle_min + 0.1 * np.arange(3), laser, np.inf).hits_in_robot
    for i, point in enumerate(points):
        beam = np.array([0.0, 0.0, angle_min + 0.1 * i])
        end = compose(compose(laser, beam), np.array([ranges[i], 0.0, 0.0]))
        np.testing.assert_allclose(point, end[:2], atol=1e-12)
