import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.filter.laser.evidence_model import UsualFit, share_by_fit, short_beam_gain
from clustermcl.filter.settings import SensorSettings


def test_a_scan_counts_less_the_worse_its_best_pose_fits() -> None:
    sensor = SensorSettings(hit_weight=0.75, random_weight=0.25, hit_sigma_m=0.15, max_range_m=30.0)
    best = math.log(0.75 / (math.sqrt(2.0 * math.pi) * 0.15) + 0.25 / 30.0)
    assert share_by_fit(best, sensor) == 1.0
    assert share_by_fit(best + 1e-9, sensor) == 1.0, "rounding"
    assert share_by_fit(best - 0.5, sensor) == pytest.approx(0.5)
    assert share_by_fit(best - 1.5, sensor) == pytest.approx(0.25)


def fit_after(*scans: float) -> UsualFit:
    """The usual fit after these scans; all are far apart."""
    fit = UsualFit()
    for scan in scans:
        fit = fit.after(scan, 1.0)
    return fit


def test_a_fall_of_the_fit_beyond_its_variation_is_detected_within_two_scans() -> None:
    steady = [3.0, 3.2] * 20
    assert not fit_after(*steady).has_fallen
    assert fit_after(*steady, -2.0, -2.0).has_fallen
    assert not fit_after(*[-10.0, 3.0] * 20, -10.0, -10.0).has_fallen, "among people it varies"


def test_a_fallen_fit_is_reported_until_scans_fit_again_or_it_becomes_usual() -> None:
    fallen = [3.0, 3.2] * 20 + [-5.0] * 5
    assert fit_after(*fallen).has_fallen
    assert not fit_after(*fallen, 3.1).has_fallen
    assert not fit_after(*fallen, *[-5.0] * 5).has_fallen


def test_a_fit_that_falls_slowly_is_not_detected() -> None:
    assert not fit_after(*np.linspace(3.0, -3.0, 400).tolist()).has_fallen


def test_the_usual_fit_follows_new_scans_and_those_that_fit_badly_less() -> None:
    usual = UsualFit(3.0, 1.0)
    assert usual.after(4.0, 0.5).mean == pytest.approx(3.0 + 0.1 * 0.5)
    fallen = usual.after(-7.0, 0.5)
    assert fallen.has_fallen
    assert fallen.after(3.0, 0.5).shortfall == 0.0
    assert (fallen.mean, fallen.shortfall) == pytest.approx((3.0 - 10.0 * 0.1 * 0.5 / 5.0, 7.0))


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50), st.floats(0.0, 1.0))
def test_the_usual_fit_stays_finite_for_any_scans(scans: list[float], news: float) -> None:
    fit = UsualFit()
    for scan in scans:
        fit = fit.after(scan, news)
    assert fit.mean is not None
    assert math.isfinite(fit.mean + fit.shortfall)
    assert fit.variance > 0.0


def test_short_beams_gain_where_people_have_stood_before_and_nowhere_else() -> None:
    settings = SensorSettings()
    assert short_beam_gain(0.0, settings) == short_beam_gain(0.01, settings) == 0.0
    assert 1.5 < short_beam_gain(0.1, settings) < short_beam_gain(0.5, settings) < 4.0
