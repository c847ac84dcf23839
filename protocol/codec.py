"""Messages to bytes and back: MessagePack maps by msgpack, checked by msgspec."""

from typing import Any, TypeVar

import msgpack
import msgspec

from protocol.errors import MalformedMessageError
from protocol.message import Message

MAX_MESSAGE_BYTES = 64 * 1024 * 1024
"""Larger messages are refused unread; a 20,000 x 20,000 map is far smaller once compressed."""

M = TypeVar("M")


def encode(message: Message) -> bytes:
    """The message as one MessagePack map."""
    plain = msgspec.to_builtins(message, builtin_types=(bytes,))
    packed: bytes = msgpack.packb(plain, use_bin_type=True)
    return packed


def decode(data: bytes, expected: type[M]) -> M:
    """The message in `data`, checked field by field.

    Args:
        data: what came from the wire.
        expected: a message class, or a union of them.

    Raises:
        MalformedMessageError: it is not MessagePack, or not the message it should be.
    """
    name = getattr(expected, "__name__", str(expected))
    if len(data) > MAX_MESSAGE_BYTES:
        raise MalformedMessageError(expected=name, problem=f"{len(data)} bytes are too many")
    try:
        plain: Any = msgpack.unpackb(data, raw=False, strict_map_key=True)
        return msgspec.convert(plain, expected)
    except msgspec.ValidationError as error:
        raise MalformedMessageError(expected=name, problem=str(error)) from None
    except (ValueError, TypeError, msgpack.UnpackException) as error:
        problem = f"{type(error).__name__}: {error}".strip(": ")
        raise MalformedMessageError(expected=name, problem=problem) from None
