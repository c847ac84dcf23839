from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.soak.schedule import Kind, planned


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32), st.floats(1.0, 60.0))
def test_a_seed_gives_one_schedule_in_order_and_in_time(seed: int, every_s: float) -> None:
    faults = planned(seed, first_s=5.0, last_s=600.0, every_s=every_s)
    assert faults == planned(seed, first_s=5.0, last_s=600.0, every_s=every_s)
    assert all(5.0 <= fault.at_s <= 600.0 for fault in faults)
    assert all(first.at_s < second.at_s for first, second in pairwise(faults))
    assert all(0.0 <= fault.choice < 1.0 and fault.lasts_s >= 0.0 for fault in faults)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32))
def test_the_first_faults_are_one_of_each_kind(seed: int) -> None:
    faults = planned(seed, first_s=0.0, last_s=10_000.0, every_s=20.0)
    assert {fault.kind for fault in faults[: len(Kind)]} == set(Kind)


def test_faults_are_as_far_apart_as_asked_on_average() -> None:
    faults = planned(1, first_s=0.0, last_s=100_000.0, every_s=20.0)
    apart_s = np.diff([fault.at_s for fault in faults])
    # Uniform over 24 s: the mean of 5,000 has a standard deviation of 0.1 s.
    assert np.mean(apart_s) == pytest.approx(20.0, abs=0.5)
    assert apart_s.min() >= 8.0
