"""Descriptions of message types, which ROS recorders and viewers query (REP 2016)."""

from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import TIDMAP

from ros2_bridge import message_types as types
from ros2_bridge.message_types import new, response_of, type_hash, typestore

_PACKAGE = "type_description_interfaces/msg"
_ARRAY, _BOUNDED_SEQUENCE, _SEQUENCE = 48, 96, 144
"""Offsets for the number of an item's type."""
_NESTED = 1
_FILLER: Any = ("structure_needs_at_least_one_member", (Nodetype.BASE, ("uint8", 0)))


def get_type_description(request: Any) -> Any:
    """Answer `GetTypeDescription`: describe a message type and those of its fields."""
    name, problem = request.type_name, ""
    if name not in typestore().fielddefs:
        problem = "this node has no message of that type"
    elif request.type_hash != type_hash(name, humble=False):
        problem = f"the type's hash here is {type_hash(name, humble=False)}"
    if problem:
        failed = {"successful": False, "failure_reason": problem}
        return new(response_of(types.GET_TYPE_DESCRIPTION), **failed)
    own, *others = _with_nested(name)
    described = {one: _description(one) for one in (own, *sorted(others))}
    sources = [
        new(f"{_PACKAGE}/TypeSource", type_name=one, encoding="msg", raw_file_contents=_source(one))
        for one in described
    ]
    whole = new(
        f"{_PACKAGE}/TypeDescription",
        type_description=described.pop(own),
        referenced_type_descriptions=list(described.values()),
    )
    return new(
        response_of(types.GET_TYPE_DESCRIPTION),
        successful=True,
        type_description=whole,
        type_sources=sources if request.include_type_sources else [],
    )


def _with_nested(name: str) -> list[str]:
    """Return the names of a type and of all types nested in it."""
    found = [name]
    for one in found:  # which grows
        for _, kind in typestore().fielddefs[one][1]:
            (node, inner), _, _ = _parts(kind)
            if node == Nodetype.NAME and inner not in found:
                found.append(inner)
    return found


def _parts(kind: Any) -> tuple[Any, int, int]:
    """Return the type of a field's items, the offset of its number, and the capacity."""
    node, about = kind
    if node == Nodetype.ARRAY:
        return about[0], _ARRAY, about[1]
    if node == Nodetype.SEQUENCE:
        return about[0], _BOUNDED_SEQUENCE if about[1] else _SEQUENCE, about[1]
    return kind, 0, 0


def _description(name: str) -> Any:
    fields = [_field(*field) for field in typestore().fielddefs[name][1] or [_FILLER]]
    return new(f"{_PACKAGE}/IndividualTypeDescription", type_name=name, fields=fields)


def _field(name: str, kind: Any) -> Any:
    (node, about), added, capacity = _parts(kind)
    nested, number, longest = "", _NESTED, 0
    if node == Nodetype.NAME:
        nested = about
    else:
        longest = about[1] if about[0] == "string" else 0
        number = TIDMAP["bounded_string" if longest else about[0]]
    about_type = new(
        f"{_PACKAGE}/FieldType",
        type_id=added + number,
        capacity=capacity,
        string_capacity=longest,
        nested_type_name=nested,
    )
    return new(f"{_PACKAGE}/Field", name=name, type=about_type)


def _source(name: str) -> str:
    text: str = typestore().generate_msgdef(name, ros_version=2)[0]
    return text.partition("=" * 80)[0]
