"""Files that carry a checksum of their content, so that a damaged one is detected."""

import hashlib

import msgspec

from clustermcl.protocol.conversion import decoded


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    sha256: bytes
    content: bytes = msgspec.field(name="checkpoint")


def with_checksum(content: bytes) -> bytes:
    """Return the content of a file that `without_checksum` reads."""
    return msgspec.msgpack.encode(_File(sha256=hashlib.sha256(content).digest(), content=content))


def without_checksum(data: bytes) -> bytes:
    """Return the content of a file.

    Raises:
        ValueError: the file is damaged.
    """
    kept = decoded(data, _File)  # its errors are ValueErrors
    if hashlib.sha256(kept.content).digest() != kept.sha256:
        raise ValueError("its checksum is wrong")
    return kept.content
