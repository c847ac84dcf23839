"""A recording's file as bytes: a signature, then blocks that are each complete or worth nothing.

A block is its length, its checksum, and so many bytes of one deflate stream that goes through the
whole file, flushed at the block's end; in it are records as MessagePack. So a file that is cut
off anywhere, by a kill or by a copy made while it was written, is good up to its last whole block.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import msgspec

from coordinator.recorder.records import Head, Record

SIGNATURE = b"MCLFLY1\n"
"""Its number rises when the form of blocks changes; what is in them goes by the head's version."""
MAX_BLOCK_BYTES = 256 * 1024 * 1024
"""Of a block, unpacked."""
LEVEL = 3
"""Of deflate; higher ones save little and cost much."""

_LENGTH_AND_CHECKSUM = struct.Struct("<II")
_NO_WRAPPER = -zlib.MAX_WBITS


class UnreadableError(ValueError):
    """The bytes are no recording, or one that this version cannot read."""


@dataclass(frozen=True)
class Contents:
    """What could be read of a file."""

    head: Head | None = None
    """None: it ends before its head does."""
    records: list[Record] = field(default_factory=list)
    cut_bytes: int = 0
    """At the end, that make no whole block."""


class BlockWriter:
    """Makes the bytes of one file."""

    def __init__(self) -> None:
        self._deflate = zlib.compressobj(LEVEL, zlib.DEFLATED, _NO_WRAPPER)
        self._encoder = msgspec.msgpack.Encoder()

    def first(self, head: Head) -> bytes:
        """How the file begins."""
        return SIGNATURE + self._block(self._encoder.encode(head))

    def next(self, records: Sequence[Record]) -> bytes:
        """More records."""
        return self._block(self._encoder.encode(records))

    def _block(self, data: bytes) -> bytes:
        packed = self._deflate.compress(data) + self._deflate.flush(zlib.Z_SYNC_FLUSH)
        return _LENGTH_AND_CHECKSUM.pack(len(packed), zlib.crc32(packed)) + packed


def read(data: bytes, version: str) -> Contents:
    """All whole blocks of a file.

    Args:
        data: the file, perhaps cut off.
        version: of this software.

    Raises:
        UnreadableError: it is no recording, or of another version.
    """
    if not data.startswith(SIGNATURE[: len(data)]):
        raise UnreadableError("no flight recording, or one in the form of another version")
    offset = len(SIGNATURE)
    inflate, head, records = zlib.decompressobj(_NO_WRAPPER), None, list[Record]()
    while (block := _block_at(data, offset)) is not None:
        try:
            plain = inflate.decompress(block, MAX_BLOCK_BYTES)
            if inflate.unconsumed_tail:
                raise UnreadableError("a block is too large")
            if head is None:
                head = _head(plain, version)
            else:
                records += _RECORDS.decode(plain)
        except (msgspec.DecodeError, zlib.error, RecursionError) as error:
            raise UnreadableError(
                f"its checksums are right, but not what is in it: {error}"
            ) from None
        offset += _LENGTH_AND_CHECKSUM.size + len(block)
    return Contents(head, records, max(len(data) - offset, 0))


class _Version(msgspec.Struct, frozen=True):
    version: str


_RECORDS = msgspec.msgpack.Decoder(list[Record])


def _head(plain: bytes, version: str) -> Head:
    found = msgspec.msgpack.decode(plain, type=_Version).version
    if found != version:
        raise UnreadableError(
            f"recorded by version {found}, this is {version}: replay it with that one"
        )
    return msgspec.msgpack.decode(plain, type=Head)


def _block_at(data: bytes, offset: int) -> bytes | None:
    begin = offset + _LENGTH_AND_CHECKSUM.size
    if begin > len(data):
        return None
    length, checksum = _LENGTH_AND_CHECKSUM.unpack_from(data, offset)
    block = data[begin : begin + length]
    if length == 0 or len(block) < length:  # zeros are what a power cut leaves
        return None
    return block if zlib.crc32(block) == checksum else None
