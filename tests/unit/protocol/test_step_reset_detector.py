from collections.abc import Iterable

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from protocol.step_reset_detector import NEEDED, StepResetDetector
from tests.unit.coordinator.reports import scan

NEWEST = scan(100)  # stamped with its step in seconds


def taken(stamped: Iterable[tuple[int, int]]) -> list[bool]:
    numbering = StepResetDetector()
    scans = [msgspec.structs.replace(scan(step), stamp_ns=s * 10**9) for step, s in stamped]
    return [numbering.starts_anew(one, NEWEST) for one in scans]


def test_newer_scans_of_low_steps_in_a_row_are_a_new_count() -> None:
    assert taken([(0, 101), (1, 102), (2, 103)]) == [False, False, True]


@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 100)), max_size=20))
def test_scans_that_repeat_or_come_late_are_none(stamped: list[tuple[int, int]]) -> None:
    assert not any(taken(stamped))


def test_a_scan_with_a_wrong_stamp_is_none_however_often_it_comes() -> None:
    assert not any(taken([(50, 500)] * 20))


def test_a_late_scan_in_between_begins_the_proof_again() -> None:
    assert NEEDED == 3
    assert not any(taken([(0, 101), (1, 102), (99, 99), (2, 103), (3, 104)]))
