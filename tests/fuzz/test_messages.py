import contextlib
from typing import Any

import msgpack
import msgspec
from hypothesis import given
from hypothesis import strategies as st

from clustermcl.protocol.arrays import ArrayBlob
from clustermcl.protocol.codec import decode, encode
from clustermcl.protocol.errors import MalformedMessageError
from clustermcl.protocol.message import Message
from clustermcl.protocol.steps import MapMessage
from clustermcl.protocol.work import Reported
from clustermcl.recordings.maps.map_message import from_message
from tests.fuzz.any_message import any_message, message_types, messages, plain_trees
from tests.fuzz.effort import cases
from tests.fuzz.mutations import damaged

EXPECTED: list[Any] = [*message_types(), Reported]
expected_types = st.sampled_from(EXPECTED)


def read(data: bytes, expected: Any) -> None:
    """Decode; whatever is an array in it must be one, or say that it is none."""
    with contextlib.suppress(MalformedMessageError):
        read_arrays(decode(data, expected))


def read_arrays(value: object) -> None:
    if isinstance(value, ArrayBlob):
        array = value.array()
        assert array.nbytes == len(value.data)
    elif isinstance(value, msgspec.Struct):
        for name in value.__struct_fields__:
            with contextlib.suppress(MalformedMessageError):
                read_arrays(getattr(value, name))
    elif isinstance(value, tuple):
        for item in value:
            read_arrays(item)


@cases(0.15)
@given(any_message())
def test_a_message_is_decoded_as_it_was_encoded_or_refused(message: Message) -> None:
    packed = encode(message)
    try:
        back = decode(packed, type(message))
    except MalformedMessageError as refused:
        if refused.kind not in ("field", "impossible"):
            raise
    else:
        assert encode(back) == packed  # bytes, for a NaN is not equal to itself


@cases(0.2)
@given(damaged(any_message().map(encode)), expected_types)
def test_damaged_messages_are_refused_or_read(data: bytes, expected: Any) -> None:
    read(data, expected)


@cases(0.1)
@given(plain_trees(), expected_types)
def test_any_tree_is_refused_or_read(tree: Any, expected: Any) -> None:
    read(msgpack.packb(tree), expected)


@cases(0.15)
@given(st.data())
def test_a_message_with_one_wrong_field_is_refused_or_read(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(message_types()))
    plain = msgpack.unpackb(encode(data.draw(messages(kind))))
    name = data.draw(st.sampled_from([*plain, "more"]))
    read(msgpack.packb(plain | {name: data.draw(plain_trees())}), kind)


@cases(0.02)
@given(messages(MapMessage))
def test_a_map_message_is_a_map_or_refused(message: Message) -> None:
    assert isinstance(message, MapMessage)
    with contextlib.suppress(MalformedMessageError):
        from_message(message)
