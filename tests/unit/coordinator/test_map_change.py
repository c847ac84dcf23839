from coordinator.change_detectors import MapChangeDetector
from tests.unit.coordinator.reports import scan


def followed(*scans: tuple[int, str]) -> list[bool]:
    detector = MapChangeDetector()
    return [detector.has_changed(scan(step, digest=digest), "ours") for step, digest in scans]


def test_three_scans_of_another_map_in_a_row_are_a_bridge_that_has_it() -> None:
    assert followed((7, "new"), (8, "new"), (9, "new")) == [False, False, True]


def test_its_steps_may_have_begun_anew() -> None:
    assert followed((90, "ours"), (0, "new"), (1, "new"), (2, "new"))[-1]


def test_a_bridge_that_waits_for_a_belief_says_the_same_step_again() -> None:
    assert followed((7, "new"), (7, "new"), (7, "new"))[-1]


def test_a_scan_of_our_own_map_between_means_that_the_bridge_is_still_there() -> None:
    assert not any(followed((7, "new"), (8, "new"), (8, "ours"), (9, "new"), (10, "new")))


def test_scans_of_several_maps_and_steps_that_go_back_are_no_bridge() -> None:
    assert not any(followed((7, "a"), (8, "b"), (9, "a"), (10, "b"), (9, "b"), (8, "b"), (7, "b")))
