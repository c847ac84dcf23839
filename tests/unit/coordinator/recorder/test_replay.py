import tempfile
from pathlib import Path

import hypothesis
from hypothesis import strategies as st

from clustermcl.coordinator.recorder.replay import replayed
from clustermcl.coordinator.recorder.ring import files_in
from clustermcl.filter.laser.sensor_model import SensorModel
from clustermcl.protocol.answers import Belief, Relocalize, SetPose
from tests.unit.coordinator.living import Living
from tests.unit.coordinator.recorder.recorded import VERSION, Recordings, as_bytes, beliefs

SMALL_FILES = 150_000
"""Of a ring whose files hold a few steps each."""

ACTIONS = st.one_of(
    st.just(("drive", 0)),
    st.just(("drive", 0)),
    st.just(("drive", 0)),
    st.tuples(st.just("lose worker"), st.integers(0, 2)),
    st.tuples(st.just("add worker"), st.integers(0, 2)),
    st.tuples(st.just("wait"), st.integers(1, 3)),
    st.tuples(st.just("set pose"), st.integers(1, 4)),
    st.just(("relocalize", 0)),
    st.tuples(st.just("die"), st.integers(0, 12)),
    st.tuples(st.just("new map"), st.integers(0, 1)),
)


def live(living: Living, actions: list[tuple[str, int]]) -> None:
    """Drive with the given faults; a dead coordinator is restarted a step later."""
    step = 0
    for number, (action, value) in enumerate(actions):
        name = f"w{value}"
        if action == "drive":
            living.drive(step)
            step += 1
            if living.coordinator is None:
                living.revive()
        elif action == "lose worker" and name in living.workers:
            living.kill_worker(name)
        elif action == "add worker" and name not in living.workers:
            living.start_worker(name)
        elif action == "wait":
            living.wait(value)
        elif action == "set pose":
            pose = (float(value), 2.0, 0.5)
            living.command(SetPose(sender="c", command_id=str(number), pose=pose))
        elif action == "relocalize":
            living.command(Relocalize(sender="c", command_id=str(number)))
        elif action == "die":
            living.dies_in = value
        elif action == "new map":
            living.map_digest, living.scans = f"map {value}", []


def test_a_coordinator_that_takes_over_gives_up_the_old_map(model: SensorModel) -> None:
    living = Living(model)
    live(living, [("drive", 0)] * 12)
    living.coordinator, living.map_digest, living.scans = None, "map 1", []
    living.drive(12)
    living.revive()
    assert living.coordinator is not None
    for step in range(13, 32):
        living.drive(step)
    assert living.coordinator.state.map_digest == "map 1"
    assert living.beliefs[31][-1].state != "searching"


@hypothesis.settings(deadline=None, max_examples=10)
@hypothesis.example([("new map", 1), *[("drive", 0)] * 20])
@hypothesis.given(st.lists(ACTIONS, min_size=5, max_size=30))
def test_a_recording_and_each_of_its_files_are_replayed_to_the_same_beliefs_whatever_fails(
    model: SensorModel, actions: list[tuple[str, int]]
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings = Recordings(folder, max_bytes=SMALL_FILES)
        living = Living(model, made=recordings.make)
        live(living, [*[("drive", 0)] * 12, *actions, *[("drive", 0)] * 6])
        whole = as_bytes(beliefs(recordings.replay()))
        alone: list[Belief] = []
        for file in files_in(folder):
            with tempfile.TemporaryDirectory() as other:
                (Path(other) / file.name).write_bytes(file.read_bytes())
                alone += beliefs([happening for _, happening in replayed(Path(other), VERSION)])
        assert as_bytes(alone) == whole
        left = files_in(folder)
        # Where a file is larger than a third of the ring, the first ones have gone.
        assert len(left) > 2 or not left[0].stem.endswith("-000000")
