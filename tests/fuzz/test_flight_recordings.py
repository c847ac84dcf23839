"""Whatever is in a flight recording, it is replayed or refused in one sentence."""

import contextlib
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from coordinator.recorder.blocks import BlockWriter
from coordinator.recorder.records import Head, Record
from coordinator.recorder.replay import FlightRecordingError, opened, replayed
from coordinator.recorder.ring import files_in
from tests.fuzz.effort import cases
from tests.fuzz.mutations import damaged, with_other_numbers
from tests.unit.coordinator.living import Living, symmetric_room
from tests.unit.coordinator.recorder.recorded import VERSION, Recordings
from tests.unit.coordinator.recorder.test_replay import live

NAME = f"{7:017d}-000001.flight"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("flight")


@cache
def recording() -> tuple[Head, list[Record]]:
    """A file that begins with a snapshot: of a search, of clusters, of a worker that was lost."""
    with TemporaryDirectory() as name:
        living = Living(symmetric_room(), made=Recordings(Path(name), 200_000).make)
        live(living, [*[("drive", 0)] * 9, ("lose worker", 1), *[("drive", 0)] * 3])
        live(living, [("set pose", 2), *[("drive", 0)] * 20])
        with opened(files_in(Path(name))[-2], VERSION) as reader:
            assert reader.head is not None
            return reader.head, list(reader.records())


def replay(folder: Path, data: bytes) -> int:
    (folder / NAME).write_bytes(data)
    return sum(1 for _ in replayed(folder, VERSION))


def file_of(head: Head, records: list[Record]) -> bytes:
    writer = BlockWriter()
    return writer.first(head) + writer.next(records)


def test_the_recording_is_replayed_from_its_snapshot(folder: Path) -> None:
    head, records = recording()
    assert head.snapshot
    assert replay(folder, file_of(head, records)) > 5


@cases(0.02)
@given(st.data())
def test_damaged_bytes_are_refused_or_cut_off(folder: Path, data: st.DataObject) -> None:
    content = data.draw(damaged(st.just(file_of(*recording()))))
    with contextlib.suppress(FlightRecordingError):
        replay(folder, content)


@cases(0.03)
@given(st.data())
def test_a_snapshot_with_other_numbers_is_replayed_or_refused(
    folder: Path, data: st.DataObject
) -> None:
    head, records = recording()
    snapshot = data.draw(
        damaged(st.just(head.snapshot)) | with_other_numbers(st.just(head.snapshot))
    )
    with contextlib.suppress(FlightRecordingError):
        replay(folder, file_of(msgspec.structs.replace(head, snapshot=snapshot), records))


@cases(0.03)
@given(st.data())
def test_heads_and_events_with_other_numbers_are_replayed_or_refused(
    folder: Path, data: st.DataObject
) -> None:
    encode, writer = msgspec.msgpack.encode, BlockWriter()
    head, records = (with_other_numbers(st.just(encode(part))) for part in recording())
    content = writer.first(msgspec.Raw(data.draw(head)))  # type: ignore[arg-type] # encoded already
    content += writer._block(data.draw(records))
    with contextlib.suppress(FlightRecordingError):
        replay(folder, content)
