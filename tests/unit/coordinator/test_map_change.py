from coordinator.change_detectors import MapChangeDetector
from tests.unit.coordinator.reports import scan


def followed(*scans: tuple[int, str]) -> list[bool]:
    detector = MapChangeDetector()
    return [detector.has_changed(scan(step, digest=digest), "ours") for step, digest in scans]


def test_three_consecutive_scans_of_another_map_show_a_new_map() -> None:
    assert followed((7, "new"), (8, "new"), (9, "new")) == [False, False, True]


def test_a_new_map_is_detected_although_steps_begin_again() -> None:
    assert followed((90, "ours"), (0, "new"), (1, "new"), (2, "new"))[-1]


def test_repeated_scans_of_another_map_count() -> None:
    assert followed((7, "new"), (7, "new"), (7, "new"))[-1]


def test_a_scan_of_the_present_map_in_between_prevents_a_change() -> None:
    assert not any(followed((7, "new"), (8, "new"), (8, "ours"), (9, "new"), (10, "new")))


def test_scans_of_several_maps_or_with_decreasing_steps_show_no_new_map() -> None:
    assert not any(followed((7, "a"), (8, "b"), (9, "a"), (10, "b"), (9, "b"), (8, "b"), (7, "b")))
