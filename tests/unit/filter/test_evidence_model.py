import math

import numpy as np
import pytest

from clustermcl.filter.laser.evidence_model import (
    evidence_weight,
    residual,
    way,
)
from clustermcl.filter.poses import between
from clustermcl.filter.settings import BeliefSettings, SensorSettings

RULES = BeliefSettings(view_distance_m=0.8, view_turn_rad=1.6, evidence_residual=0.5)


def test_evidence_weighs_less_the_worse_the_best_place_fits() -> None:
    shares = [evidence_weight(1.0, bad, RULES) for bad in (0.0, 0.25, 0.5, 1.0)]
    assert shares == pytest.approx([1.0, 0.8, 0.5, 0.2])
    assert evidence_weight(0.3, 0.5, RULES) == pytest.approx(0.15)
    assert evidence_weight(0.3, math.nan, RULES) == 0.3, "no beam was weighed"
    literal = BeliefSettings(evidence_residual=math.inf)
    assert evidence_weight(1.0, 9.0, literal) == 1.0


def test_the_residual_is_the_loss_against_beams_that_all_end_on_obstacles() -> None:
    sensor = SensorSettings(hit_weight=0.75, random_weight=0.25, hit_sigma_m=0.15, max_range_m=30.0)
    best = math.log(0.75 / (math.sqrt(2.0 * math.pi) * 0.15) + 0.25 / 30.0)
    assert residual(best, sensor) == 0.0
    assert residual(best - 1.5, sensor) == pytest.approx(1.5)
    assert residual(best + 1e-9, sensor) == 0.0, "rounding"
    assert math.isnan(residual(math.nan, sensor))


def test_the_way_of_a_motion_is_its_distance_and_its_wrapped_turn() -> None:
    before, after = np.array([3.0, 4.0, math.pi - 0.05]), np.array([3.3, 4.4, 0.05 - math.pi])
    assert way(between(before, after)) == pytest.approx((0.5, 0.1))
    assert way(between(after, before)) == pytest.approx((0.5, 0.1))
    assert way(between(before, before)) == (0.0, 0.0)
