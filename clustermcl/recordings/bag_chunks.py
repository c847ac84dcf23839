"""Unpacks chunks of run logs within limits: 92 kB of zstd may unpack to gigabytes."""

import os
import zlib
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO
from typing import BinaryIO

import zstandard
from mcap.exceptions import EndOfFile
from mcap.records import Channel, Chunk, McapRecord, Schema
from mcap.stream_reader import StreamReader

from clustermcl.runtime.compressed import most_unpacked

MOST_BYTES = 2**26
"""Limit for one unpacked chunk or message [bytes]; recorders write chunks of some megabytes."""
_MOST_DEFINED_BYTES = 2**24
"""Limit for all schemas and topic names of an MCAP file [bytes]."""
_MOST_RECORD_BYTES = MOST_BYTES + 2**16
"""Limit for an MCAP record [bytes]; the library would allocate whatever a damaged one says."""
_FREE_BYTES = 2**27
"""All chunks of a file may have these bytes whatever their ratio: the largest map, twice."""


def unpacked(compression: str, packed: bytes, most: int = MOST_BYTES) -> bytes:
    """Unpack a chunk.

    Raises:
        ValueError: the chunk unpacks to more than `most` bytes, or the compression is unknown.
        Exception: an error of the compression's library: the chunk is damaged.
    """
    match compression:
        case "":
            return packed
        case "zstd":
            content: bytes = zstandard.ZstdDecompressor().stream_reader(packed).read(most + 1)
        case other:
            raise ValueError(f"chunks are compressed by {other!r:.20}")
    if len(content) > most:
        raise ValueError(f"a chunk of {len(packed)} bytes unpacks to more than {most}")
    return content


def mcap_records(file: BinaryIO) -> Iterator[McapRecord]:
    """Yield the records of an MCAP file and of its chunks, holding one chunk at a time.

    Raises:
        Exception: an error of the library: from here on the file is cut off or damaged.
    """
    reader = StreamReader(file, emit_chunks=True, record_size_limit=_MOST_RECORD_BYTES)
    defined: dict[tuple[type, int], int] = {}
    defined_bytes = 0
    left = most_unpacked(os.fstat(file.fileno()).st_size, _FREE_BYTES)
    for outer in reader.records:
        if isinstance(outer, Chunk):
            content = unpacked(outer.compression, outer.data, min(left, MOST_BYTES))
            left -= len(content)
            records = _chunk_records(outer, content)
        else:
            records = iter((outer,))
        for record in records:
            if isinstance(record, (Schema, Channel)):  # readers keep all of these in memory
                size = len(record.data) if isinstance(record, Schema) else len(record.topic)
                defined_bytes += size - defined.get((type(record), record.id), 0)
                defined[type(record), record.id] = size
                if defined_bytes > _MOST_DEFINED_BYTES:
                    raise ValueError("its schemas and names of topics are too long")
            yield record


def _chunk_records(chunk: Chunk, content: bytes) -> Iterator[McapRecord]:
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("the checksum of a chunk is wrong")
    with suppress(EndOfFile):
        yield from StreamReader(BytesIO(content), skip_magic=True, emit_chunks=True).records
