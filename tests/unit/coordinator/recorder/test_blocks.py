"""A recording's file, whole, cut off, broken, and of others."""

import io
import random
import resource
import zlib
from dataclasses import dataclass

import pytest

from coordinator.events import ReportArrived, TimePassed, WorkerJoined
from coordinator.recorder import blocks
from coordinator.recorder.blocks import (
    LEVEL,
    MAX_BLOCK_BYTES,
    SIGNATURE,
    BlockReader,
    BlockWriter,
    UnreadableError,
)
from coordinator.recorder.records import (
    BeliefsSaid,
    EventTold,
    Head,
    Record,
    Started,
)
from particle_filter.settings import FilterSettings
from process_runtime.settings import CoordinatorSettings
from protocol.answers import Belief
from tests.unit.coordinator.recorder.recorded import VERSION
from tests.unit.coordinator.reports import tracked

BELIEF = Belief(
    sender="coordinator", step=3, stamp_ns=2**62, odom_from_robot=(0.1, -0.2, 0.3),
    state="ambiguous", hypotheses=(), searching=True, term=7,
)  # fmt: skip
BLOCKS: list[list[Record]] = [
    [EventTold(1, WorkerJoined("w0")), EventTold(2, TimePassed())],
    [EventTold(2**62, ReportArrived("w0", tracked("c0", 3, 0.1, (1.0, 2.0, 0.1 + 0.2))))],
    [BeliefsSaid((BELIEF,)), EventTold(4, TimePassed())],
]


def head(version: str = VERSION) -> Head:
    started = Started(
        sender="coordinator", filter_settings=FilterSettings(), settings=CoordinatorSettings(),
        version=version, now_ns=0, term=7, known=None,
    )  # fmt: skip
    return Head(
        version=version,
        made_with="",
        now_ns=0,
        wall_ns=0,
        first_event=0,
        started=started,
        snapshot=b"",
    )


def file_of(blocks: list[list[Record]]) -> bytes:
    writer = BlockWriter()
    return writer.first(head()) + b"".join([writer.next(records) for records in blocks])


@dataclass
class Contents:
    head: Head | None
    records: list[Record]
    cut_bytes: int


def read(data: bytes, version: str) -> Contents:
    reader = BlockReader(io.BytesIO(data), version)
    return Contents(reader.head, list(reader.records()), reader.cut_bytes)


def test_what_was_written_is_read() -> None:
    contents = read(file_of(BLOCKS), VERSION)
    assert contents.head == head()
    assert contents.records == [record for records in BLOCKS for record in records]
    assert contents.cut_bytes == 0


@pytest.mark.parametrize("whole", range(len(BLOCKS)))
def test_a_file_that_is_cut_at_any_byte_is_good_up_to_its_last_whole_block(whole: int) -> None:
    begin, end = len(file_of(BLOCKS[:whole])), len(file_of(BLOCKS[: whole + 1]))
    data = file_of(BLOCKS)
    for length in range(begin, end):
        contents = read(data[:length], VERSION)
        assert contents.records == [record for records in BLOCKS[:whole] for record in records]
        assert contents.cut_bytes == length - begin


def test_a_file_that_is_cut_within_its_head_holds_nothing() -> None:
    data = file_of([])
    for length in range(len(data)):
        assert read(data[:length], VERSION).head is None


def test_zeros_after_a_power_cut_are_a_cut_off_tail() -> None:
    assert (
        read(file_of(BLOCKS) + bytes(4096), VERSION).records
        == read(file_of(BLOCKS), VERSION).records
    )


def test_of_a_file_with_any_bytes_changed_nothing_wrong_is_read() -> None:
    rng, data = random.Random(1), file_of(BLOCKS)
    right = read(data, VERSION).records
    for _ in range(500):
        broken = bytearray(data)
        broken[rng.randrange(len(SIGNATURE), len(data))] ^= rng.randrange(1, 256)
        records = read(bytes(broken), VERSION).records
        assert records == right[: len(records)]


def test_what_is_no_recording_or_of_another_version_is_refused() -> None:
    with pytest.raises(UnreadableError, match="no flight recording"):
        read(b"P5 800 600 255", VERSION)
    with pytest.raises(UnreadableError, match="recorded by an older version, in a form"):
        read(b"MCLFLY1\n" + bytes(100), VERSION)
    writer = BlockWriter()
    with pytest.raises(UnreadableError, match=r"recorded by version 0\.9, this is test"):
        read(writer.first(head("0.9")), VERSION)


def test_what_is_no_record_is_refused_although_its_checksum_is_right() -> None:
    writer = BlockWriter()
    data = writer.first(head()) + writer._block(b"\x93\x01\x02\x03")
    with pytest.raises(UnreadableError, match="checksums are right"):
        read(data, VERSION)


def test_many_records_are_written_in_blocks_of_a_bounded_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As a disk that was slow for long leaves them."""
    monkeypatch.setattr(blocks, "MAX_BLOCK_BYTES", 2 * blocks.BLOCK_BYTES)
    large: Record = EventTold(1, WorkerJoined("w" * 300_000))
    assert read(file_of([[large] * 40]), VERSION).records == [large] * 40


def test_records_of_a_file_are_never_all_in_memory_at_once() -> None:
    """A file of 3 MB that holds 2 GB."""
    data = file_of([[EventTold(1, WorkerJoined("w" * 1_000_000))] * 10] * 200)
    assert len(data) < 20_000_000
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    reader = BlockReader(io.BytesIO(data), VERSION)
    assert sum(1 for _ in reader.records()) == 2_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 200_000


@pytest.mark.parametrize("unpacked", [MAX_BLOCK_BYTES + 1, 2_000_000_000])
def test_a_block_that_unpacks_without_end_is_refused(unpacked: int) -> None:
    writer = BlockWriter()
    data = writer.first(head())
    packer = zlib.compressobj(LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    packed = b"".join(packer.compress(bytes(1_000_000)) for _ in range(unpacked // 1_000_000 + 1))
    packed += packer.flush(zlib.Z_SYNC_FLUSH)
    data += blocks._LENGTH_AND_CHECKSUM.pack(len(packed), zlib.crc32(packed)) + packed
    with pytest.raises(UnreadableError, match="too large"):
        read(data, VERSION)
