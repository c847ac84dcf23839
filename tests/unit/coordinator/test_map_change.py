import pytest

from clustermcl.coordinator.change_detectors import MapChangeDetector
from tests.unit.coordinator.reports import scan


@pytest.mark.parametrize(("scans", "changes"), [
    ("7 new, 8 new, 9 new", True),
    ("7 new, 8 new", False),
    ("90 ours, 0 new, 1 new, 2 new", True),
    ("7 new, 7 new, 7 new", True),
    ("7 new, 8 new, 8 ours, 9 new, 10 new", False),
    ("7 a, 8 b, 9 a, 10 b, 9 b, 8 b, 7 b", False),
])  # fmt: skip
def test_three_consecutive_scans_of_one_other_map_show_a_new_map(scans: str, changes: bool) -> None:
    detector = MapChangeDetector()
    for step, digest in map(str.split, scans.split(", ")):
        changed = detector.has_changed(scan(int(step), digest=digest), "ours")
    assert changed == changes
