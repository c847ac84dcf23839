import json
from typing import Any

import pytest

from clustermcl.view.step_archive import LOOK_BACK_STEPS, StepArchive


def shown(archive: StepArchive, step: int) -> dict[str, object]:
    return {topic: json.loads(bytes(frame)) for topic, frame in archive.at(step).items()}


@pytest.mark.parametrize(("added", "step", "expected"), [
    ([(n, "step", n) for n in range(5)], 3, {"step": 3}),
    ([(1, "cloud 7", "old"), (1, "step", 1), (2, "step", 2), (3, "cloud 7", "new")], 2,
     {"cloud 7": "old", "step": 2}),
    ([(1, "cloud 7", "old"), (2, "step", 2), (3, "cloud 7", "new")], 3,
     {"cloud 7": "new", "step": 2}),
    ([(1, "cloud 7", "old"), (LOOK_BACK_STEPS + 2, "step", 2)], LOOK_BACK_STEPS + 2, {"step": 2}),
    ([(1, "step", "first"), (1, "step", "second")], 1, {"step": "second"}),
], ids=[
    "as it was added", "valid until the next of its topic", "replaced by the next of its topic",
    "not long after its step", "the second of a step",
])  # fmt: skip
def test_a_step_has_the_last_frame_of_each_topic(
    added: list[tuple[int, str, object]], step: int, expected: dict[str, object]
) -> None:
    archive = StepArchive()
    for one in added:
        archive.add(*one)
    assert shown(archive, step) == expected


@pytest.mark.parametrize(("limit", "length", "oldest"), [
    ({"max_steps": 10}, 1, 90), ({"max_bytes": 1000}, 50, 99), ({"max_bytes": 10}, 1000, 100),
], ids=["steps", "bytes", "a frame larger than the archive"])  # fmt: skip
def test_frames_beyond_the_limit_drop_the_oldest_steps(
    limit: dict[str, Any], length: int, oldest: int
) -> None:
    archive = StepArchive(**limit)
    for step in range(100):
        archive.add(step, "step", list(range(step, step + length)))
    for step in (0, 89, 90, 99):
        expected = {"step": list(range(step, step + length))} if step >= oldest else {}
        assert shown(archive, step) == expected
