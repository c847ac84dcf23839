import pytest

from clustermcl.coordinator.change_detectors import (
    IN_TIME_NS,
    LATE_NS,
    STEPS,
    MapChangeDetector,
    OverloadDetector,
)
from clustermcl.coordinator.slow_workers import GIVEN_UP_AFTER, GIVEN_UP_LATER
from clustermcl.filter.settings import BeliefSettings
from tests.unit.coordinator.reports import scan, tracked
from tests.unit.coordinator.test_coordinator import NORTH, SOUTH, Story


def with_two_clusters() -> Story:
    """Clusters c0 and c1 are tracked by two of three workers, well after their hand-over."""
    story = Story("a", "b", "c")
    story.bootstrapped()
    for step in range(1, 4):
        story.tracks(step, at_s=10.0 + step, north=0.1, south=0.1)
    assert story.places["c0"] != story.places["c1"]
    return story


def test_an_overload_begins_if_most_steps_are_late_and_ends_if_they_are_well_in_time() -> None:
    detector = OverloadDetector()
    for number in range(5 * STEPS):
        detector.on_step_decided(10 * LATE_NS if number % 5 < 2 else 1_000)
        assert not detector.is_overloaded
    for waited_ns in (2 * LATE_NS, IN_TIME_NS + 1):
        for _ in range(STEPS):
            detector.on_step_decided(waited_ns)
        assert detector.is_overloaded, "it would soon be again"
    for _ in range(STEPS):
        detector.on_step_decided(IN_TIME_NS)
    assert not detector.is_overloaded


def slow(story: Story, first: int, steps: int, *, south: float | None = 0.1) -> float:
    """Steps whose reports come 0.3 s after their scan, or that must do without one."""
    for step in range(first, first + steps):
        story.scan(step, at_s=20.0 + step)
        story.report(tracked("c0", step, 0.1, NORTH), at_s=20.3 + step)
        if south is not None:
            story.report(tracked("c1", step, south, SOUTH), at_s=20.3 + step)
        story.tick(at_s=20.6 + step)
    return 21.0 + first + steps


def test_the_status_shows_an_overload_and_periodic_searches_wait_until_it_ends() -> None:
    story = with_two_clusters()
    every = BeliefSettings().search_every_steps
    at_s = slow(story, 4, every + STEPS)
    assert story.status(at_s).overloaded
    assert not story.beliefs[-1].searching
    first = 4 + every + STEPS
    for step in range(first, first + 2 * STEPS):
        story.tracks(step, at_s=100.0 + every + step, north=0.1, south=0.1)
    assert any(belief.searching for belief in story.beliefs[-2 * STEPS :])


def test_the_slowest_worker_keeps_its_job_for_longer_if_all_workers_are_slow() -> None:
    story = with_two_clusters()
    slow(story, 4, STEPS)
    slower = story.places["c1"]
    story.frozen.add(slower)
    slow(story, 4 + STEPS, GIVEN_UP_AFTER + 1, south=None)
    assert story.places["c1"] == slower
    slow(story, 5 + STEPS + GIVEN_UP_AFTER, GIVEN_UP_LATER, south=None)
    story.tick(at_s=200.0)
    assert story.places["c1"] != slower


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
