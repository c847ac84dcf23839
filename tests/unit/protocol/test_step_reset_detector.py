from collections.abc import Iterable

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.step_reset_detector import (
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


FAR = 100 + HUGE_JUMP + 1


@pytest.mark.parametrize(("stamped", "indicates"), [
    ([(0, 101), (1, 102), (2, 103)], True),
    ([(step, step) for step in range(NEEDED_OF_OLDER)], True),
    ([(FAR, 101), (FAR + 1, 102), (FAR + 2, 103)], True),
    ([(FAR - 1, 101), (FAR, 102), (FAR + 1, 103)], False),
    ([(50, 500)] * 20, False),
    ([(0, 101), (1, 102), (99, 99), (2, 103), (3, 104)], False),
], ids=[
    "several newer scans of low steps", "many with older stamps: the newest may have been forged",
    "several after a huge jump", "not if the first goes on", "a repeated scan with a wrong stamp",
    "a late scan in between",
])  # fmt: skip
def test_scans_indicate_a_new_count(stamped: list[tuple[int, int]], indicates: bool) -> None:
    assert NEEDED == 3
    assert taken(stamped) == [False] * (len(stamped) - 1) + [indicates]


def test_a_jump_is_huge_from_a_number_of_steps_on() -> None:
    assert is_huge_jump(scan(FAR), NEWEST)
    assert not is_huge_jump(scan(FAR - 1), NEWEST)
    assert not is_huge_jump(scan(FAR), None)


@given(st.lists(st.tuples(st.integers(0, 99), st.integers(0, 100)), max_size=NEEDED_OF_OLDER - 1))
def test_repeated_or_late_scans_do_not_indicate_a_new_count(stamped: list[tuple[int, int]]) -> None:
    assert not any(taken(stamped))


def test_a_scan_that_continues_the_count_resets_the_detector() -> None:
    detector = StepResetDetector()
    for n in range(3 * NEEDED):
        stray = msgspec.structs.replace(scan(10**6 + n), stamp_ns=(101 + n) * 10**9)
        assert not detector.on_other_scan(stray, NEWEST)
        if n % (NEEDED - 1) == 1:
            detector.reset()
