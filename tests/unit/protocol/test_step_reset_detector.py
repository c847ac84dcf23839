from collections.abc import Iterable

import msgspec
from hypothesis import given
from hypothesis import strategies as st

from protocol.step_reset_detector import (
    HUGE_JUMP,
    NEEDED,
    NEEDED_OF_OLDER,
    StepResetDetector,
    is_huge_jump,
)
from tests.unit.coordinator.reports import scan

NEWEST = scan(100)  # stamped with its step in seconds


def taken(stamped: Iterable[tuple[int, int]]) -> list[bool]:
    numbering = StepResetDetector()
    scans = [msgspec.structs.replace(scan(step), stamp_ns=s * 10**9) for step, s in stamped]
    return [numbering.on_other_scan(one, NEWEST) for one in scans]


def test_several_newer_scans_of_low_steps_indicate_a_new_count() -> None:
    assert taken([(0, 101), (1, 102), (2, 103)]) == [False, False, True]


@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 100)), max_size=NEEDED_OF_OLDER - 1))
def test_repeated_or_late_scans_do_not_indicate_a_new_count(stamped: list[tuple[int, int]]) -> None:
    assert not any(taken(stamped))


def test_a_repeated_scan_with_a_wrong_stamp_does_not_indicate_a_new_count() -> None:
    assert not any(taken([(50, 500)] * 20))


def test_a_late_scan_in_between_resets_the_detector() -> None:
    assert NEEDED == 3
    assert not any(taken([(0, 101), (1, 102), (99, 99), (2, 103), (3, 104)]))


def test_many_scans_with_older_stamps_indicate_a_new_count() -> None:
    """The newest scan may have been a forged one, with a stamp of next year."""
    row = [(step, step) for step in range(NEEDED_OF_OLDER)]
    assert taken(row) == [False] * (NEEDED_OF_OLDER - 1) + [True]


def test_several_scans_after_a_huge_jump_indicate_a_new_count() -> None:
    far = 100 + HUGE_JUMP + 1
    assert taken([(far, 101), (far + 1, 102), (far + 2, 103)]) == [False, False, True]
    assert not any(taken([(far - 1, 101), (far, 102), (far + 1, 103)])), "the first goes on"
    assert is_huge_jump(scan(far), NEWEST)
    assert not is_huge_jump(scan(far - 1), NEWEST)
    assert not is_huge_jump(scan(far), None)


def test_a_scan_that_continues_the_count_resets_the_detector() -> None:
    detector = StepResetDetector()
    for n in range(3 * NEEDED):
        stray = msgspec.structs.replace(scan(10**6 + n), stamp_ns=(101 + n) * 10**9)
        assert not detector.on_other_scan(stray, NEWEST)
        if n % (NEEDED - 1) == 1:
            detector.reset()
