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
    packed += packer.flush()
    head = struct.pack("<QQQI", 0, 9, 1_000, 0) + text("zstd") + struct.pack("<Q", len(packed))
    return b"".join(
        [
            MCAP,
            record(1, text(profile) + text("")),
            record(6, head + packed),
            record(15, bytes(4)),
            record(2, bytes(20)),
            MCAP,
        ]
    )
