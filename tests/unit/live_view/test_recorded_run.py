"""A finished run on the page: the same steps and events as were recorded."""

import json
from pathlib import Path

import pytest

from coordinator.recorder.replay import recorded_bridge, replayed
from live_view.recorded_run import RecordedRun, flight_run
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.recorder.recorded import VERSION, Recordings
from tests.unit.live_view.messages import map_message


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RecordedRun:
    """Of 30 steps in a room with two places that look alike."""
    folder = Path(tmp_path_factory.mktemp("recording"))
    living = Living(symmetric_room(), made=Recordings(folder).make)
    for step in range(30):
        living.drive(step)
    made = RecordedRun(flight_run(replayed(folder, VERSION)), map_message(), {"robot": "r"})
    while made.replay_for(0.01):
        pass
    return made


def test_all_steps_are_shown(run: RecordedRun) -> None:
    shown = run.picture.everything()
    assert shown["system"]["link"] == "finished"
    assert not shown["system"]["commands"]
    assert shown["step"]["step"] == 29
    assert [json.loads(bytes(row))[0] for row in shown["history"]["rows"]] == list(range(30))


def test_each_step_has_its_places_pose_and_events(run: RecordedRun) -> None:
    past = run.picture.past(20)
    step, pose = (json.loads(bytes(past[topic])) for topic in ("step", "pose"))
    assert (step["step"], pose["step"]) == (20, 20)
    assert len(step["places"]) >= 2
    assert pose["pose"] == step["places"][0]["pose"]
    assert any(event["kind"] == "began" for event in past["events"])


def test_the_map_is_drawn_where_it_is_known(run: RecordedRun) -> None:
    assert run.picture.everything()["map"]["rows"] == 2
    assert run.room.map[0] == "d1"


def test_a_recording_names_its_bridge(tmp_path: Path) -> None:
    Living(symmetric_room(), made=Recordings(tmp_path).make).drive(0)
    assert recorded_bridge(tmp_path, VERSION) is not None
