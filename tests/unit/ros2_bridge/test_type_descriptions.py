"""Descriptions of types: their hash is ROS's own of that type."""

import hashlib
import json
from typing import Any

import pytest

from ros2_bridge import message_types as types
from ros2_bridge.message_types import decode, encode, new, request_of, response_of, type_hash
from ros2_bridge.type_descriptions import get_type_description
from tests.unit.ros2_bridge.test_message_types import MESSAGES

TYPES = [*MESSAGES, "type_description_interfaces/msg/FieldType", "std_msgs/msg/Empty"]


def described(ros_type: str, hashed: str = "", *, sources: bool = True) -> Any:
    """The answer as it is on the wire."""
    kind = types.GET_TYPE_DESCRIPTION
    answer = get_type_description(
        new(
            request_of(kind),
            type_name=ros_type,
            type_hash=hashed or type_hash(ros_type, humble=False),
            include_type_sources=sources,
        )
    )
    return decode(encode(answer, response_of(kind)), response_of(kind))


def as_hashed(one: Any) -> dict[str, object]:
    """A type as ROS's rule for hashes has it (REP 2011): without default values."""
    names = ("type_id", "capacity", "string_capacity", "nested_type_name")
    fields = [
        {"name": field.name, "type": {name: getattr(field.type, name) for name in names}}
        for field in one.fields
    ]
    return {"type_name": one.type_name, "fields": fields}


@pytest.mark.parametrize("ros_type", TYPES)
def test_the_hash_of_a_description_is_that_of_the_type(ros_type: str) -> None:
    answer = described(ros_type)
    assert answer.successful
    whole = answer.type_description
    content = {
        "type_description": as_hashed(whole.type_description),
        "referenced_type_descriptions": [
            as_hashed(one) for one in whole.referenced_type_descriptions
        ],
    }
    digest = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    assert f"RIHS01_{digest}" == type_hash(ros_type, humble=False)


def test_the_definition_of_each_type_is_included_on_request() -> None:
    sources = {one.type_name: one for one in described(types.TF_MESSAGE).type_sources}
    assert "geometry_msgs/msg/Quaternion" in sources
    assert sources[types.TF_MESSAGE].raw_file_contents == (
        "geometry_msgs/TransformStamped[] transforms\n"
    )
    assert not described(types.TF_MESSAGE, sources=False).type_sources


@pytest.mark.parametrize(
    ("ros_type", "hashed", "reason"),
    [
        ("invented/msg/Thing", "RIHS01_0", "this node has no message of that type"),
        (types.STRING, "RIHS01_0", "the type's hash here is RIHS01_"),
    ],
)
def test_an_unknown_type_is_refused_with_the_reason(
    ros_type: str, hashed: str, reason: str
) -> None:
    answer = described(ros_type, hashed)
    assert not answer.successful
    assert reason in answer.failure_reason
