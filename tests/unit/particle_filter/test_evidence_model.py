import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from particle_filter.evidence_model import counted, view_weight
from particle_filter.settings import BeliefSettings, SensorSettings

RULES = BeliefSettings(evidence_slope=0.25, evidence_knee=2.0)
EVIDENCE = arrays(np.float64, 5, elements=st.floats(-1e6, 1e6))


def test_a_difference_counts_in_part_up_to_the_knee_and_in_full_beyond() -> None:
    evidence = np.array([-10.0, -11.0, -12.0, -13.0, -110.0])
    expected = [0.0, -0.25, -0.5, -1.5, -98.5]
    np.testing.assert_allclose(counted(evidence, RULES), expected)


def test_more_views_err_more_and_part_of_a_view_less() -> None:
    evidence = np.array([0.0, -5.0])
    for views, expected in ((0.5, -0.25 - 4.0), (1.0, -0.5 - 3.0), (2.0, -1.0 - 1.0), (9.0, -1.25)):
        assert counted(evidence, RULES, views)[1] == pytest.approx(expected)


def test_no_view_tells_nothing_and_a_missing_report_stays_missing() -> None:
    evidence = np.array([0.0, -50.0, np.nan])
    np.testing.assert_array_equal(counted(evidence, RULES, 0.0), [0.0, 0.0, np.nan])
    np.testing.assert_array_equal(counted(evidence[::-1], RULES), [np.nan, -48.5, 0.0])
    np.testing.assert_array_equal(counted(np.full(2, np.nan), RULES), np.full(2, np.nan))
    assert counted(np.array([]), RULES).size == 0


@given(EVIDENCE)
def test_a_slope_of_one_is_the_papers_update(evidence: NDArray[np.float64]) -> None:
    literal = BeliefSettings(evidence_slope=1.0, evidence_knee=2.0)
    np.testing.assert_allclose(counted(evidence, literal), evidence - evidence.max(), atol=1e-9)


@given(EVIDENCE, st.floats(0.01, 1.0), st.floats(0.0, 10.0), st.floats(0.01, 5.0))
def test_who_fits_better_never_counts_for_less_and_nothing_counts_more_than_in_full(
    evidence: NDArray[np.float64], slope: float, knee: float, views: float
) -> None:
    told = counted(evidence, BeliefSettings(evidence_slope=slope, evidence_knee=knee), views)
    lost = evidence.max() - evidence
    order = np.argsort(evidence)
    assert np.all(np.diff(told[order]) >= 0.0)
    assert np.all(told <= 0.0)
    assert np.all(-told <= lost + 1e-9)
    assert np.all(-told >= slope * lost - 1e-9)


SENSOR = SensorSettings(view_distance_m=0.2, view_turn_rad=0.4)


@pytest.mark.parametrize(
    ("after", "views"),
    [
        ((0.0, 0.0, 0.0), 0.0),
        ((0.1, 0.0, 0.0), 0.5),
        ((0.0, -0.05, 0.0), 0.25),
        ((0.0, 0.0, -0.1), 0.25),
        ((0.06, 0.08, 0.1), 0.75),
        ((0.2, 0.0, 0.4), 1.0),
        ((7.0, 0.0, 3.0), 1.0),
    ],
)
def test_a_scan_is_a_new_view_as_far_as_the_robot_has_moved(
    after: tuple[float, float, float], views: float
) -> None:
    assert view_weight(np.zeros(3), np.array(after), SENSOR) == pytest.approx(views)


def test_turns_go_round_and_only_the_way_between_counts() -> None:
    before, after = np.array([3.0, 4.0, math.pi - 0.05]), np.array([3.0, 4.0, 0.05 - math.pi])
    assert view_weight(before, after, SENSOR) == pytest.approx(0.25)
