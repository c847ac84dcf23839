"""Every message type of the wire, and arbitrary messages that have the right fields."""

from functools import cache
from typing import Any

from hypothesis import strategies as st
from msgspec import inspect

import clustermcl.protocol.codec  # noqa: F401 - knows, and so imports, all modules with messages
from clustermcl.protocol.message import Message


def message_types() -> list[type[Message]]:
    """All of them, by name; a new one is found by itself."""
    return sorted(Message.__subclasses__(), key=lambda kind: kind.__name__)


@cache
def messages(kind: type[Message]) -> st.SearchStrategy[Message]:
    """Messages of a type, with fields of the right types and any values at all."""
    return values_of(kind)


def values_of(kind: Any) -> st.SearchStrategy[Any]:
    """Values of a type, with fields of the right types and any values at all."""
    return _values(inspect.type_info(kind))


@cache
def any_message() -> st.SearchStrategy[Message]:
    return st.sampled_from(message_types()).flatmap(messages)


@cache
def plain_trees() -> st.SearchStrategy[Any]:
    """Whatever MessagePack can say."""
    leaves = (
        st.none()
        | st.booleans()
        | st.integers(-(2**63), 2**64 - 1)
        | st.floats()
        | st.text(max_size=20)
        | st.binary(max_size=40)
    )
    return st.recursive(
        leaves,
        lambda inner: (
            st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8), inner, max_size=5)
        ),
        max_leaves=20,
    )


def _values(info: inspect.Type) -> st.SearchStrategy[Any]:  # noqa: PLR0911 - one for each type
    match info:
        case (
            inspect.StructType(cls=cls, fields=fields)
            | inspect.DataclassType(cls=cls, fields=fields)
        ):
            local = getattr(cls, "local", ())  # never sent, see `clustermcl.belief.part`
            drawn = {one.name: _values(one.type) for one in fields if one.name not in local}
            return st.builds(cls, **drawn)
        case inspect.UnionType(types=types):
            return st.one_of(map(_values, types))
        case inspect.LiteralType(values=values):
            return st.sampled_from(list(values))
        case inspect.VarTupleType(item_type=item):
            return st.lists(_values(item), max_size=3).map(tuple)
        case inspect.ListType(item_type=item):
            return st.lists(_values(item), max_size=3)
        case inspect.TupleType(item_types=items):
            return st.tuples(*map(_values, items))
        case inspect.DictType(key_type=key, value_type=value):
            return st.dictionaries(_values(key), _values(value), max_size=3)
        case inspect.IntType(gt=int() as above, le=int() as most):
            return st.integers(above + 1, most)
        case inspect.FloatType(ge=None, gt=None, le=None, lt=None):
            pass
        case inspect.FloatType(ge=low, gt=above, le=high, lt=below):
            return st.floats(
                min_value=low if above is None else above,
                max_value=high if below is None else below,
                exclude_min=above is not None,
                exclude_max=below is not None,
                allow_nan=False,
            )
    return _LEAVES[type(info)]  # a KeyError: a type that no message had before


_LEAVES: dict[type[inspect.Type], st.SearchStrategy[Any]] = {
    inspect.IntType: st.integers(-3, 1000) | st.integers(-(2**63), 2**63 - 1),
    inspect.FloatType: st.floats(-100.0, 100.0) | st.floats(),
    inspect.StrType: st.text(max_size=20),
    inspect.BytesType: st.binary(max_size=64),
    inspect.BoolType: st.booleans(),
    inspect.NoneType: st.none(),
    inspect.CustomType: plain_trees(),  # `object`: a work order's settings
}
