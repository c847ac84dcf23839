import json

from live_view.step_archive import LOOK_BACK_STEPS, StepArchive


def shown(archive: StepArchive, step: int) -> dict[str, object]:
    return {topic: json.loads(bytes(frame)) for topic, frame in archive.at(step).items()}


def test_an_archived_frame_is_returned_unchanged() -> None:
    archive = StepArchive()
    for step in range(5):
        archive.add(step, "step", {"step": step})
    assert shown(archive, 3) == {"step": {"step": 3}}


def test_a_frame_is_valid_until_the_next_of_its_topic() -> None:
    archive = StepArchive()
    archive.add(1, "cloud 7", "old")
    archive.add(1, "step", 1)
    archive.add(2, "step", 2)
    archive.add(3, "cloud 7", "new")
    assert shown(archive, 2) == {"cloud 7": "old", "step": 2}
    assert shown(archive, 3) == {"cloud 7": "new", "step": 2}


def test_a_frame_is_not_shown_long_after_its_step() -> None:
    archive = StepArchive()
    archive.add(1, "cloud 7", "old")
    archive.add(LOOK_BACK_STEPS + 2, "step", 2)
    assert shown(archive, LOOK_BACK_STEPS + 2) == {"step": 2}


def test_a_second_frame_of_a_step_replaces_the_first() -> None:
    archive = StepArchive()
    archive.add(1, "step", "first")
    archive.add(1, "step", "second")
    assert shown(archive, 1) == {"step": "second"}


def test_steps_beyond_the_limit_drop_the_oldest() -> None:
    archive = StepArchive(max_steps=10)
    for step in range(100):
        archive.add(step, "step", step)
    assert shown(archive, 89) == {}
    assert shown(archive, 90) == {"step": 90}


def test_bytes_beyond_the_limit_drop_the_oldest_steps() -> None:
    archive = StepArchive(max_bytes=1000)
    for step in range(100):
        archive.add(step, "step", list(range(step, step + 50)))
    assert shown(archive, 0) == {}
    assert shown(archive, 99) == {"step": list(range(99, 149))}


def test_a_frame_larger_than_the_archive_is_dropped() -> None:
    archive = StepArchive(max_bytes=10)
    archive.add(1, "step", list(range(1000)))
    assert shown(archive, 1) == {}
