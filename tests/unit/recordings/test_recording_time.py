import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from recordings.recording import monotonic_times

STAMPS = st.lists(st.integers(-(10**18), 10**18), max_size=30)


@given(STAMPS)
def test_corrected_times_never_decrease(stamps: list[int]) -> None:
    assert np.all(np.diff(monotonic_times(np.array(stamps, np.int64))) >= 0)


@given(STAMPS.filter(len))
def test_no_stamp_is_corrected_by_more_than_the_largest_step_back(stamps: list[int]) -> None:
    times = np.array(stamps, np.int64)
    largest_step_back = int((np.maximum.accumulate(times) - times).max())
    assert np.abs(monotonic_times(times) - times).max() <= largest_step_back
