import contextlib
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from clustermcl.coordinator.recorder.records import Head, RecordedEvent
from clustermcl.coordinator.recorder.replay import replayed
from clustermcl.coordinator.recorder.ring import EVENTS, HEAD, files_in
from clustermcl.protocol.errors import MapFileError, RecordingError
from clustermcl.recordings.maps.grid_map import GridMap
from clustermcl.recordings.maps.map_file import load_map
from clustermcl.recordings.recording import open_recording
from clustermcl.recordings.run_log import LogMessage, RunLog, RunLogReader
from clustermcl.runtime.settings import BridgeSettings
from clustermcl.sensor_bridge.recorded import steps_of
from clustermcl.simulator.worlds.catalogue import world
from clustermcl.view.recorded_run import RecordedRun
from tests.fuzz.effort import cases
from tests.fuzz.mutations import damaged, with_other_numbers
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.recorder.recorded import VERSION, Recordings, write_file
from tests.unit.coordinator.recorder.test_replay import live

NAME = f"{7:017d}-000001.mcap"


@cache
def recording() -> tuple[bytes, list[LogMessage]]:
    """A file that begins with a snapshot: of a search, of clusters, of a worker that was lost."""
    with TemporaryDirectory() as name:
        living = Living(symmetric_room(), made=Recordings(Path(name), 600_000).make)
        live(living, [*[("drive", 0)] * 9, ("lose worker", 1), *[("drive", 0)] * 3])
        live(living, [("set pose", 2), *[("drive", 0)] * 20])
        file = files_in(Path(name))[-2]
        return file.read_bytes(), list(RunLogReader(file).messages())


def parts() -> tuple[Head, list[RecordedEvent]]:
    head, *batches = (m.data for m in recording()[1] if m.topic in (HEAD, EVENTS))
    decode = msgspec.msgpack.Decoder(list[RecordedEvent]).decode
    events = [event for batch in batches for event in decode(batch)]
    return msgspec.msgpack.decode(head, type=Head), events


def replay(folder: Path) -> int:
    return sum(1 for _ in replayed(folder, VERSION))


def test_the_recording_is_replayed_from_its_snapshot(folder: Path) -> None:
    head, events = parts()
    assert head.snapshot
    write_file(folder / NAME, head, *events)
    assert replay(folder) > 5


@cases(0.02)
@given(st.data())
def test_damaged_bytes_are_refused_or_cut_off(folder: Path, data: st.DataObject) -> None:
    (folder / NAME).write_bytes(data.draw(damaged(st.just(recording()[0]))))
    with contextlib.suppress(RecordingError):
        replay(folder)


@cases(0.03)
@given(st.data())
def test_a_snapshot_with_other_numbers_is_replayed_or_refused(
    folder: Path, data: st.DataObject
) -> None:
    head, events = parts()
    snapshot = data.draw(
        damaged(st.just(head.snapshot)) | with_other_numbers(st.just(head.snapshot))
    )
    write_file(folder / NAME, replace(head, snapshot=snapshot), *events)
    with contextlib.suppress(RecordingError):
        replay(folder)


@cases(0.03)
@given(st.data())
def test_heads_and_events_with_other_numbers_are_replayed_or_refused(
    folder: Path, data: st.DataObject
) -> None:
    head, events = parts()
    changed = data.draw(with_other_numbers(st.just(msgspec.msgpack.encode(head))))
    at = data.draw(st.integers(0, len(events) - 1))
    other = data.draw(with_other_numbers(st.just(msgspec.msgpack.encode(events[at]))))
    with_other: list[RecordedEvent | msgspec.Raw] = [*events]
    with_other[at] = msgspec.Raw(other)
    for begin in (msgspec.Raw(changed), head):
        write_file(folder / NAME, begin, *with_other)
        with contextlib.suppress(RecordingError):
            replay(folder)


def numbers_changed(content: bytes) -> st.SearchStrategy[bytes]:
    """The same JSON with other numbers."""
    packed = st.just(msgspec.msgpack.encode(msgspec.json.decode(content)))
    return with_other_numbers(packed).map(msgspec.msgpack.decode).map(msgspec.json.encode)


@cases(0.03)
@given(st.data())
def test_messages_with_other_contents_are_used_or_refused(
    folder: Path, data: st.DataObject
) -> None:
    messages = [message for message in recording()[1] if message.topic[1] != "c"]
    topic = data.draw(st.sampled_from(sorted({message.topic for message in messages})))
    chosen = [number for number, message in enumerate(messages) if message.topic == topic]
    at = data.draw(st.sampled_from(chosen))
    content = messages[at].data
    other = data.draw(damaged(st.just(content)) | numbers_changed(content))
    path = folder / "run.mcap"
    with RunLog(path) as log:
        log.on_map(world("cross").map, 0)
        for number, message in enumerate(messages):
            written = msgspec.Raw(other if number == at else message.data)
            log.write(message.topic, written, message.at_ns)
    with contextlib.suppress(RecordingError):
        run = RecordedRun(path)
        while run.read_for(1.0):
            pass
    with contextlib.suppress(RecordingError):
        list(steps_of(open_recording(path, BridgeSettings()), BridgeSettings(), ""))


@cases(0.03)
@given(st.data())
def test_a_map_with_other_contents_is_a_map_or_refused(folder: Path, data: st.DataObject) -> None:
    path = folder / "run.mcap"
    with RunLog(path) as log:
        log.on_map(GridMap(np.eye(4, 5, dtype=np.int8), 0.05, (1.0, 2.0, 0.5)), 0)
    (message,) = RunLogReader(path).messages()
    other = data.draw(damaged(st.just(message.data)) | numbers_changed(message.data))
    with RunLog(path) as log:
        log.write(message.topic, msgspec.Raw(other), 0)
    with contextlib.suppress(MapFileError):
        load_map(path)
