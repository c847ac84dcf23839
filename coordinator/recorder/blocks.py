"""A recording's file as bytes: a signature, then blocks that are each complete or worth nothing.

A block is its length, its checksum, and so many bytes of one deflate stream that goes through the
whole file, flushed at the block's end; in it are records as MessagePack. So a file that is cut
off anywhere, by a kill or by a copy made while it was written, is good up to its last whole block.
"""

import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import BinaryIO, TypeVar

import msgspec

from coordinator.recorder.records import Head, Record

SIGNATURE = b"MCLFLY2\n"
"""Its number rises when the form of blocks changes; what is in them goes by the head's version."""
OLDER = (b"MCLFLY1\n",)
BLOCK_BYTES = 1_000_000
"""A block ends with the record that passes this, before it is packed."""
MAX_BLOCK_BYTES = 32_000_000
"""Of a block, packed or not; a reader holds one at a time."""
LEVEL = 3
"""Of deflate; higher ones save little and cost much."""

_LENGTH_AND_CHECKSUM = struct.Struct("<II")
_NO_WRAPPER = -zlib.MAX_WBITS


class UnreadableError(ValueError):
    """The bytes are no recording, or one that this version cannot read."""


class BlockWriter:
    """Makes the bytes of one file."""

    def __init__(self) -> None:
        self._deflate = zlib.compressobj(LEVEL, zlib.DEFLATED, _NO_WRAPPER)
        self._encoder = msgspec.msgpack.Encoder()

    def first(self, head: Head) -> bytes:
        """How the file begins."""
        return SIGNATURE + self._block(self._encoder.encode(head))

    def next(self, records: Sequence[Record]) -> bytes:
        """More records, in one block or several."""
        blocks, size = [list[msgspec.Raw]()], 0
        for record in records:
            data = self._encoder.encode(record)
            blocks[-1].append(msgspec.Raw(data))
            size += len(data)
            if size >= BLOCK_BYTES:
                blocks.append([])
                size = 0
        return b"".join(self._block(self._encoder.encode(block)) for block in blocks if block)

    def _block(self, data: bytes) -> bytes:
        packed = self._deflate.compress(data) + self._deflate.flush(zlib.Z_SYNC_FLUSH)
        return _LENGTH_AND_CHECKSUM.pack(len(packed), zlib.crc32(packed)) + packed


class BlockReader:
    """Reads one file: its head at once, its records a block at a time.

    Args:
        file: at its beginning; perhaps cut off.
        version: of this software.

    Raises:
        UnreadableError: it is no recording, or of another version.
    """

    def __init__(self, file: BinaryIO, version: str) -> None:
        self._file, self._inflate = file, zlib.decompressobj(_NO_WRAPPER)
        signature = file.read(len(SIGNATURE))
        if signature in OLDER:
            raise UnreadableError(
                "recorded by an older version, in a form that is not read any more"
            )
        if not SIGNATURE.startswith(signature):
            raise UnreadableError("no flight recording, or one of a newer version")
        self._whole = file.tell()
        plain = self._next_block()
        self.head = None if plain is None else _head(plain, version)
        """None: the file ends before its head does."""

    def records(self) -> Iterator[Record]:
        """What follows the head, up to the last whole block.

        Raises:
            UnreadableError: a whole block does not hold what it should.
        """
        while self.head is not None and (plain := self._next_block()) is not None:
            yield from _decoded(_RECORDS, plain)

    @property
    def cut_bytes(self) -> int:
        """At the end, that make no whole block; ask after all records."""
        return self._file.seek(0, os.SEEK_END) - self._whole

    def _next_block(self) -> bytes | None:
        packed = self._next_packed()
        if packed is None:
            return None
        try:
            plain = self._inflate.decompress(packed, MAX_BLOCK_BYTES)
        except zlib.error as error:
            raise _unexpected(error) from None
        if self._inflate.unconsumed_tail:
            raise UnreadableError("a block is too large")
        self._whole = self._file.tell()
        return plain

    def _next_packed(self) -> bytes | None:
        begin = self._file.read(_LENGTH_AND_CHECKSUM.size)
        if len(begin) < _LENGTH_AND_CHECKSUM.size:
            return None
        length, checksum = _LENGTH_AND_CHECKSUM.unpack(begin)
        if not 0 < length <= MAX_BLOCK_BYTES:  # zeros are what a power cut leaves
            return None
        packed = self._file.read(length)
        is_whole = len(packed) == length and zlib.crc32(packed) == checksum
        return packed if is_whole else None


class _Version(msgspec.Struct, frozen=True):
    version: str


T = TypeVar("T")

_VERSIONS = msgspec.msgpack.Decoder(_Version)
_HEADS = msgspec.msgpack.Decoder(Head)
_RECORDS = msgspec.msgpack.Decoder(list[Record])


def _head(plain: bytes, version: str) -> Head:
    found = _decoded(_VERSIONS, plain).version
    if found != version:
        raise UnreadableError(
            f"recorded by version {found}, this is {version}: replay it with that one"
        )
    return _decoded(_HEADS, plain)


def _decoded(decoder: "msgspec.msgpack.Decoder[T]", plain: bytes) -> T:
    try:
        return decoder.decode(plain)
    except (msgspec.DecodeError, RecursionError) as error:
        raise _unexpected(error) from None


def _unexpected(error: Exception) -> UnreadableError:
    return UnreadableError(f"its checksums are right, but not what is in it: {error}")
