"""Conversion of plain values to types by msgspec, which only one thread at a time may inspect."""

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
