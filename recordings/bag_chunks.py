"""Unpacks chunks of bags and run logs within limits: 92 kB of zstd may unpack to gigabytes."""

import bz2
import zlib
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

MOST_BYTES = 2**26
"""Limit for one unpacked chunk or message [bytes]; recorders write chunks of some megabytes."""
MOST_OVERLAPPING_BYTES = 2**27
"""Limit for the chunks that overlap at any time, which are unpacked together [bytes]."""
MOST_FILE_BYTES = 2**33
"""Limit for a packed or damaged bag, which is unpacked to the disk [bytes]."""
_MOST_DEFINED_BYTES = 2**24
"""Limit for all schemas and topic names of an MCAP file [bytes]."""
_MOST_RECORD_BYTES = 2**30
"""Limit for an MCAP record [bytes]; the library would allocate whatever a damaged one says."""


def unpacked(compression: str, packed: bytes, most: int = MOST_BYTES) -> bytes:
    """Unpack a chunk.

    Args:
        compression: name of the compression in ROS 1 and MCAP; empty: none.
        packed: the bytes of the chunk.
        most: limit for the unpacked size [bytes]; never more than `MOST_BYTES`.

    Raises:
        ValueError: the chunk unpacks to more, or the compression is unknown.
        Exception: an error of the compression's library: the chunk is damaged.
    """
    most = min(most, MOST_BYTES)
    match compression:
        case "" | "none":
            return packed
        case "bz2":
            content = bz2.BZ2Decompressor().decompress(packed, most + 1)
        case "lz4":
            content = LZ4FrameDecompressor().decompress(packed, most + 1)
        case "zstd":
            content = zstandard.ZstdDecompressor().stream_reader(packed).read(most + 1)
        case other:
            raise ValueError(f"chunks are compressed by {other!r:.20}")
    if len(content) > most:
        raise ValueError(f"a chunk of {len(packed)} bytes unpacks to more than {most}")
    return content


def check_unpacked(count: int) -> None:
    """Check the number of bytes unpacked from a bag so far.

    Raises:
        ValueError: there are more than `MOST_FILE_BYTES`.
    """
    if count > MOST_FILE_BYTES:
        raise ValueError(f"unpacks to more than {MOST_FILE_BYTES} bytes")


@cache
def bound_library() -> None:
    """Make `rosbags` unpack by `unpacked`, because its own functions have no limit."""
    from backports import zstd  # noqa: PLC0415 - comes with rosbags
    from rosbags.rosbag1 import reader as ros1  # noqa: PLC0415 - an extra
    from rosbags.rosbag2 import reader as ros2  # noqa: PLC0415 - see above
    from rosbags.rosbag2 import storage_mcap as mcap  # noqa: PLC0415 - see above

    class Bounded(zstd.ZstdFile):
        def read(self, size: int | None = -1) -> bytes:
            check_unpacked(self.tell())
            return super().read(size)

    ros1.decompressors |= {name: partial(unpacked, name) for name in ("bz2", "lz4")}
    mcap.DECOMPRESSORS |= {name: partial(unpacked, name) for name in ("lz4", "zstd")}
    bounded: Any = SimpleNamespace(
        decompress=partial(unpacked, "zstd"), open=lambda file, _mode: Bounded(file)
    )
    ros2.zstd = bounded  # type: ignore[attr-defined] # imported there


def check_overlaps(chunks: Iterable[Any]) -> None:
    """Check the unpacked size of the chunks of an MCAP file that overlap in time.

    Raises:
        ValueError: at some time it is more than `MOST_OVERLAPPING_BYTES`.
    """
    changes = []
    for chunk in chunks:
        changes.append((chunk.message_start_time, 0, chunk.uncompressed_size))
        end = max(chunk.message_start_time, chunk.message_end_time)
        changes.append((end, 1, -chunk.uncompressed_size))
    held = 0
    for _, _, change in sorted(changes):
        held += change
        if held > MOST_OVERLAPPING_BYTES:
            raise ValueError(f"chunks of {held} bytes, unpacked, overlap in time")


def mcap_records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of an MCAP file and of its chunks, holding one chunk at a time.

    Raises:
        Exception: an error of the library: from here on the file is cut off or damaged.
    """
    reader = StreamReader(file, emit_chunks=True, record_size_limit=_MOST_RECORD_BYTES)
    defined: dict[tuple[type, int], int] = {}
    for outer in reader.records:
        for record in _chunk_records(outer) if isinstance(outer, Chunk) else (outer,):
            if isinstance(record, (Schema, Channel)):  # readers keep all of these in memory
                size = len(record.data) if isinstance(record, Schema) else len(record.topic)
                defined[type(record), record.id] = size
                if size > _MOST_DEFINED_BYTES or sum(defined.values()) > _MOST_DEFINED_BYTES:
                    raise ValueError("its schemas and names of topics are too long")
            yield record


def _chunk_records(chunk: Chunk) -> Iterator[McapRecord]:
    content = unpacked(chunk.compression, chunk.data)
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk is wrong")
    with suppress(EndOfFile):
        yield from StreamReader(BytesIO(content), skip_magic=True, emit_chunks=True).records


def recover_mcap(damaged: Path, recovered: Path) -> None:
    """Copy the messages before the first damaged byte into a new file with an index.

    `rosbags` needs the index, which a truncated file lacks, as a recorder writes it last.
    """
    with damaged.open("rb") as source, recovered.open("wb") as target:
        writer = Writer(target, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schemas: dict[int, int] = {0: 0}
        channels: dict[int, int] = {}
        with suppress(Exception):  # of any kind: from here on the file is damaged
            for record in mcap_records(source):
                _copy_record(record, writer, schemas, channels)
                check_unpacked(target.tell())
        writer.finish()  # type: ignore[no-untyped-call] # the library's


def _copy_record(
    record: McapRecord, writer: Writer, schemas: dict[int, int], channels: dict[int, int]
) -> None:
    match record:
        case Schema() if record.id not in schemas:
            made = writer.register_schema(record.name, record.encoding, record.data)
            schemas[record.id] = made
        case Channel() if record.id not in channels:
            channels[record.id] = writer.register_channel(
                record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
            )
        case Message():
            writer.add_message(
                channels[record.channel_id],
                record.log_time,
                record.data,
                record.publish_time,
                record.sequence,
            )
