"""Conversion of plain values to types by msgspec, which only one thread at a time may inspect."""

import hashlib
from threading import Lock
from types import ModuleType
from typing import Any, TypeVar

import msgspec

T = TypeVar("T")

_prepared: set[object] = set()
_preparing = Lock()


def converted(value: object, kind: type[T], *, strict: bool = True) -> T:
    """Do as `msgspec.convert`, in any thread."""
    prepare(kind)
    return msgspec.convert(value, kind, strict=strict)  # noqa: TID251 - prepared


def decoded(data: bytes | str, kind: type[T], encoding: ModuleType = msgspec.msgpack) -> T:
    """Do as `msgspec.msgpack.decode` or that of another encoding, in any thread.

    Only for data whose size was checked, and that no other process can send: see `codec.decode`.
    """
    prepare(kind)
    value: T = encoding.decode(data, type=kind)
    return value


def prepare(*kinds: Any) -> None:
    """Have msgspec inspect types in one thread: two that do it at once crash the process."""
    for kind in kinds:
        if kind not in _prepared:
            with _preparing:
                msgspec.msgpack.Decoder(kind)  # noqa: TID251 - the lock is held
                _prepared.add(kind)


class _File(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file with a checksum of its content, so that a damaged one is detected."""

    sha256: bytes
    content: bytes = msgspec.field(name="checkpoint")


def with_checksum(content: bytes) -> bytes:
    """Return the content of a file that `without_checksum` reads."""
    return msgspec.msgpack.encode(_File(sha256=hashlib.sha256(content).digest(), content=content))


def without_checksum(data: bytes) -> bytes:
    """Return the content of a file; a `ValueError`: it is damaged."""
    kept = decoded(data, _File)  # its errors are ValueErrors
    if hashlib.sha256(kept.content).digest() != kept.sha256:
        raise ValueError("its checksum is wrong")
    return kept.content
