"""Encode messages as MessagePack maps; decode them with msgpack, check them with msgspec.

Only msgpack can limit a list's length before it allocates it. `msgspec.msgpack` decodes five times
faster, but would allocate a list of four billion items.
"""

import re
from functools import cache
from typing import Any, TypeVar, get_args

import msgpack
import msgspec

from clustermcl.protocol.conversion import converted
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import Message
from clustermcl.protocol.validity import problem_of

MAX_ITEMS = 20_000
"""Limit for the items of one list or map, and for the lists and maps of one message.

Real messages have less than a hundredth of it. MessagePack can announce a list of four billion
items in five bytes, or nest a million empty lists in a megabyte. Either would take gigabytes of
memory before a field could be checked.
"""

_NOT_MESSAGEPACK = (
    ValueError,  # a UnicodeDecodeError is one too
    TypeError,
    OverflowError,
    RecursionError,
    msgpack.UnpackException,
)

M = TypeVar("M")


@cache
def max_bytes(expected: Any) -> int:
    """Return the size limit of a message class or a union of message classes [bytes]."""
    kinds: tuple[type[Message], ...] = get_args(expected) or (expected,)
    return max(kind.max_bytes for kind in kinds)


def encode(message: Message) -> bytes:
    return msgspec.msgpack.encode(message)


def decode(data: bytes, expected: type[M]) -> M:
    """Decode a message; check its fields, then the plausibility of its numbers.

    Raises:
        MalformedMessageError: the data is too large, not MessagePack, or not a valid `expected`.
    """

    def malformed(kind: str, problem: object) -> MalformedMessageError:
        name = " or ".join(one.__name__ for one in get_args(expected) or (expected,))
        return MalformedMessageError(expected=name, problem=str(problem), kind=kind)

    most = max_bytes(expected)  # type: ignore[arg-type] # classes and unions can be hashed
    if len(data) > most:
        raise malformed("too large", f"{len(data)} bytes; the limit is {most}")
    try:
        message = converted(_unpacked(data), expected)
    except msgspec.ValidationError as error:
        raise malformed("schema" if "$.schema" in str(error) else "field", error) from None
    except _NOT_MESSAGEPACK as error:
        problem = f"{type(error).__name__}: {error}".strip(": ")
        raise malformed("not MessagePack", problem) from None
    if impossible := problem_of(message):
        raise malformed("impossible", impossible)
    return message


def refusal_of(message: Message) -> str | None:
    """Return why a receiver would refuse this message; None if it would not."""
    try:
        decode(encode(message), type(message))
    except MalformedMessageError as error:
        return re.sub(r"Expected (.*) - at `\$\.(.*)`", r"\2: expected \1", error.problem)
    except OverflowError as error:  # an integer of more than 64 bits
        return str(error)
    return None


def _unpacked(data: bytes) -> Any:
    """Decode to plain values; refuse data that would need far more memory than its bytes."""
    left = MAX_ITEMS
    bounded = len(data) <= MAX_ITEMS  # a list or map takes at least a byte

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
