"""A frozen or slow worker, as events without a network."""

from coordinator.events import TimePassed, WorkerLeft
from coordinator.instructions import Instruction, SendOrder
from coordinator.slow_workers import FIRST_PAUSE_NS, GIVEN_UP_AFTER
from tests.unit.coordinator.reports import tracked
from tests.unit.coordinator.test_coordinator import NORTH, SECOND, SOUTH, Story

DEADLINE_S = 0.5
"""The default of `coordinator.step_deadline_s`."""


class StoryWithFrozen(Story):
    """Some workers do not answer orders."""

    def __init__(self, *workers: str) -> None:
        self.frozen: set[str] = set()
        super().__init__(*workers)

    def follow(self, instructions: list[Instruction]) -> None:
        super().follow(
            [
                instruction
                for instruction in instructions
                if not (isinstance(instruction, SendOrder) and instruction.worker in self.frozen)
            ]
        )

    def tick(self, *, at_s: float) -> None:
        self.follow(self.coordinator.handle(TimePassed(), int(at_s * SECOND)))


def with_two_clusters() -> StoryWithFrozen:
    """Clusters c0 and c1 are tracked by two of three workers, well after their hand-over."""
    story = StoryWithFrozen("a", "b", "c")
    story.bootstrapped()
    for step in range(1, 4):
        story.tracks(step, at_s=10.0 + step, north=0.1, south=0.1)
    assert story.places["c0"] != story.places["c1"]
    return story


def test_a_frozen_worker_delays_one_step_and_then_loses_its_job() -> None:
    story = with_two_clusters()
    frozen = story.places["c1"]
    story.frozen.add(frozen)
    story.tracks(4, at_s=20.0, north=0.1, south=None)
    assert story.beliefs[-1].step == 3, "it is waited for"
    story.tick(at_s=20.0 + DEADLINE_S)
    assert story.beliefs[-1].step == 4
    for step in range(5, 4 + GIVEN_UP_AFTER):
        assert story.places["c1"] == frozen
        story.tracks(step, at_s=20.0 + step, north=0.1, south=None)
        assert story.beliefs[-1].step == step, "and not a second time"
        assert story.beliefs[-1].missing == ("c1",)
    assert story.places["c1"] not in (frozen, story.places["c0"]), "another has its job"
    step = 4 + GIVEN_UP_AFTER
    story.tracks(step, at_s=20.0 + step, north=0.1, south=0.1)
    assert story.beliefs[-1].missing == ()


def test_a_thawed_worker_gets_jobs_again_after_its_pause() -> None:
    story = with_two_clusters()
    frozen = story.places["c1"]
    story.frozen.add(frozen)
    for step in range(4, 4 + GIVEN_UP_AFTER):
        story.tracks(step, at_s=20.0 + step, north=0.1, south=None)
        story.tick(at_s=20.0 + step + DEADLINE_S)
    given_up_s = 20.0 + 4 + GIVEN_UP_AFTER
    story.frozen.clear()
    story.tick(at_s=given_up_s + 1.0)  # its order is repeated, and answered
    for worker in {"a", "b", "c"} - {frozen, story.places["c0"]}:
        now_ns = int((given_up_s + 1.0) * SECOND)
        story.follow(story.coordinator.handle(WorkerLeft(worker), now_ns))
    assert story.places["c1"] == story.places["c0"], "in its pause it gets nothing"
    story.tick(at_s=given_up_s + FIRST_PAUSE_NS / SECOND + 1.0)
    assert frozen in {story.places["c0"], story.places["c1"]}


def test_a_late_report_is_not_used_but_steps_wait_for_its_worker_again() -> None:
    story = with_two_clusters()
    story.tracks(4, at_s=20.0, north=0.3, south=None)
    story.tick(at_s=20.0 + DEADLINE_S)
    before = story.beliefs[-1].hypotheses
    late = tracked("c1", 4, 0.9, SOUTH, epoch=story.epochs["c1"])
    story.report(late, at_s=20.6)
    assert story.beliefs[-1].hypotheses == before
    story.tracks(5, at_s=21.0, north=0.1, south=None)
    assert story.beliefs[-1].step == 4, "waited for"
    story.report(tracked("c1", 5, 0.1, SOUTH, epoch=story.epochs["c1"]), at_s=21.1)
    assert story.beliefs[-1].missing == ()


def test_the_only_worker_is_never_given_up() -> None:
    story = StoryWithFrozen("a")
    story.bootstrapped()
    for step in range(1, 10):
        story.scan(step, at_s=10.0 * step)
        story.tick(at_s=10.0 * step + 3.0)
    assert set(story.places.values()) == {"a"}
    story.tracks(10, at_s=200.0, north=0.1, south=0.1)
    assert story.beliefs[-1].missing == ()
    assert story.beliefs[-1].hypotheses[0].pose in (NORTH, SOUTH)
