"""Messages to bytes and back: MessagePack maps, read by msgpack, checked by msgspec.

Only msgpack bounds what it reads before it makes it; `msgspec.msgpack` reads five times faster, and
would make a list of four billion items.
"""

from threading import Lock
from typing import Any, TypeVar, get_args

import msgpack
import msgspec

from protocol.errors import MalformedMessageError
from protocol.limits import max_bytes
from protocol.message import Message
from protocol.validity import problem_of

MAX_ITEMS = 20_000
"""Of one list or map, and of lists and maps in one message: no message has a hundredth.

MessagePack may announce a list of four billion items in five bytes, or nest a million empty
ones in a megabyte; either would take gigabytes before a field could be checked.
"""

_NOT_MESSAGEPACK = (
    ValueError,  # a UnicodeDecodeError is one too
    TypeError,
    OverflowError,
    RecursionError,
    msgpack.UnpackException,
)

M = TypeVar("M")

_learnt: set[object] = set()
_learning = Lock()


def encode(message: Message) -> bytes:
    """The message as one MessagePack map."""
    return msgspec.msgpack.encode(message)


def decode(data: bytes, expected: type[M]) -> M:
    """The message in `data`, checked field by field, and then for numbers that cannot be.

    Args:
        data: what came from the wire.
        expected: a message class, or a union of them.

    Raises:
        MalformedMessageError: it is too large, not MessagePack, or not the message it should be.
    """

    def malformed(kind: str, problem: object) -> MalformedMessageError:
        name = " or ".join(one.__name__ for one in get_args(expected) or (expected,))
        return MalformedMessageError(expected=name, problem=str(problem), kind=kind)

    most = max_bytes(expected)  # type: ignore[arg-type] # classes and unions can be hashed
    if len(data) > most:
        raise malformed("too large", f"{len(data)} bytes, at most {most} are read")
    _learn(expected)
    try:
        message = msgspec.convert(_unpacked(data), expected)
    except msgspec.ValidationError as error:
        raise malformed("schema" if "$.schema" in str(error) else "field", error) from None
    except _NOT_MESSAGEPACK as error:
        problem = f"{type(error).__name__}: {error}".strip(": ")
        raise malformed("not MessagePack", problem) from None
    if impossible := problem_of(message):
        raise malformed("impossible", impossible)
    return message


def _learn(expected: type[M]) -> None:
    """Have msgspec look at a class while no other thread does: half learnt, it ends the process."""
    if expected in _learnt:
        return
    with _learning:
        msgspec.msgpack.Decoder(expected)
        _learnt.add(expected)


def _unpacked(data: bytes) -> Any:
    """Plain values; what would grow far beyond its bytes is refused while it is read."""
    left = MAX_ITEMS
    bounded = len(data) <= MAX_ITEMS  # a list or map takes a byte at least

    def counted(container: Any) -> Any:
        nonlocal left
        left -= 1
        if left < 0:
            raise ValueError(f"more than {MAX_ITEMS} lists and maps")
        return container

    return msgpack.unpackb(
        data,
        raw=False,
        strict_map_key=True,
        max_array_len=MAX_ITEMS,
        max_map_len=MAX_ITEMS,
        max_ext_len=0,
        list_hook=None if bounded else counted,
        object_hook=None if bounded else counted,
    )
