import struct
import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import pytest
from backports import zstd

from process_runtime.settings import BridgeSettings
from protocol.errors import RecordingError
from recordings import bag_chunks
from recordings.bag_chunks import MOST_BYTES, check_overlaps
from recordings.recording import open_recording
from tests.unit.recordings.bags import fixed_tf, scan, tf, written
from tests.unit.recordings.logs import scans_of

MCAP, GIGABYTES = b"\x89MCAP0\r\n", 1
SENT = [
    fixed_tf("base_link", "laser", (0.0, 0.0, 0.0)),
    *(tf(n, "odom", "base_link", (n, 0.0, 0.0)) for n in (1, 3)),
    scan(2, [1.0] * 2_000, step=0.001),
]
PACKED_IN_CHUNKS = (
    "ros1 bz2", "ros1 lz4", "mcap zstd storage", "mcap zstd message", "sqlite3 zstd message"
)  # fmt: skip
PACKED_WHOLE = ("mcap zstd file", "sqlite3 zstd file", "mcap packed")


def record(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def bomb(claimed: int) -> bytes:
    """An MCAP file with one chunk of zstd that says how much it unpacks to."""
    packer = zstd.ZstdCompressor()
    packed = b"".join(packer.compress(bytes(2**20)) for _ in range(GIGABYTES * 1024))
    packed += packer.flush()
    head = struct.pack("<QQQI", 0, 9, claimed, 0) + text("zstd") + struct.pack("<Q", len(packed))
    return b"".join(
        [
            MCAP,
            record(1, text("ros2") + text("")),
            record(6, head + packed),
            record(15, bytes(4)),
            record(2, bytes(20)),
            MCAP,
        ]
    )


@pytest.mark.parametrize("claimed", [GIGABYTES * 2**30, 1_000, 2**63 - 1])
def test_a_chunk_that_unpacks_to_gigabytes_is_refused(tmp_path: Path, claimed: int) -> None:
    file = tmp_path / "bomb.mcap"
    file.write_bytes(bomb(claimed))
    assert file.stat().st_size < 400_000
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match="unpacks to more than"):
            open_recording(file, BridgeSettings())
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * MOST_BYTES


@pytest.mark.parametrize("form", PACKED_IN_CHUNKS)
def test_chunks_and_messages_are_unpacked_up_to_their_bound(
    tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = written(tmp_path, form, SENT)
    assert len(scans_of(open_recording(bag, BridgeSettings()))) == 1
    monkeypatch.setattr(bag_chunks, "MOST_BYTES", 5_000)
    with pytest.raises(RecordingError, match="unpacks to more than 5000"):
        open_recording(bag, BridgeSettings())


@pytest.mark.parametrize("form", PACKED_WHOLE)
def test_whole_bags_are_unpacked_up_to_their_bound(
    tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = written(tmp_path, form, SENT)
    assert len(scans_of(open_recording(bag, BridgeSettings()))) == 1
    monkeypatch.setattr(bag_chunks, "MOST_FILE_BYTES", 5_000)
    with pytest.raises(RecordingError, match="unpacks to more than 5000"):
        open_recording(bag, BridgeSettings())


@dataclass(frozen=True)
class Chunk:
    message_start_time: int
    message_end_time: int
    uncompressed_size: int = MOST_BYTES


def test_overlapping_chunks_are_refused_above_a_common_limit() -> None:
    """They are unpacked together, however long the file; others one after the other."""
    check_overlaps(Chunk(n, n + 1) for n in range(1_000))
    check_overlaps(Chunk(0, 10**9, 2**20) for _ in range(128))
    for chunks in ([Chunk(0, 9)] * 3, [Chunk(0, 9), Chunk(5, 1), Chunk(5, 5)]):
        with pytest.raises(ValueError, match="overlap in time"):
            check_overlaps(chunks)
