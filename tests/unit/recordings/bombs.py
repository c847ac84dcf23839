"""An MCAP file of a few kilobytes that stands for a gigabyte."""

import struct

from backports import zstd

MCAP = b"\x89MCAP0\r\n"


def record(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", len(content)) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def bomb(profile: str) -> bytes:
    """An MCAP file with one chunk of zstd, which says that it unpacks to a kilobyte."""
    packer = zstd.ZstdCompressor()
    packed = b"".join(packer.compress(bytes(2**20)) for _ in range(1024))
    return mcap(profile, _chunk(packed + packer.flush(), 1_000))


def mcap(profile: str, *records: bytes) -> bytes:
    first, last = record(1, text(profile) + text("")), record(15, bytes(4)) + record(2, bytes(20))
    return b"".join([MCAP, first, *records, last, MCAP])


def channel(topic: str, number: int = 0) -> bytes:
    about = text(topic) + text("json") + bytes(4)
    return record(4, struct.pack("<HH", number, 0) + about)


def chunk(content: bytes) -> bytes:
    return _chunk(zstd.compress(content, 1), len(content))


def _chunk(packed: bytes, unpacked_bytes: int) -> bytes:
    head = struct.pack("<QQQI", 0, 9, unpacked_bytes, 0) + text("zstd")
    return record(6, head + struct.pack("<Q", len(packed)) + packed)
