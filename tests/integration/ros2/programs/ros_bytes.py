"""Runs where rclpy is installed and says how ROS itself writes messages, and reads ours.

On standard input a JSON object a line: `type`; `values`, of the fields in their order; `bytes`,
ours in hexadecimal; `definition`, for what knows types by their text alone. On standard output a
line each: `by`, who wrote it; `bytes`; `read_alike`, whether our bytes are read as that message.
"""

import json
import sys
from importlib import import_module
from typing import Any

from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import AbstractNestedType, BasicType, NamespacedType


def main() -> None:
    for line in sys.stdin:
        asked = json.loads(line)
        ours = bytes.fromhex(asked["bytes"])
        try:
            kind = message_class(*asked["type"].split("/"))
        except (ImportError, AttributeError):
            answer = by_definition(asked["type"], asked["definition"], ours)
        else:
            message = filled(kind, asked["values"])
            answer = {
                "by": "rclpy",
                "bytes": serialize_message(message).hex(),
                "read_alike": deserialize_message(ours, kind) == message,
            }
        print(json.dumps(answer))


def message_class(package: str, _: str, name: str) -> Any:
    """The class of a message; of a service's half where its name ends so."""
    service, _, half = name.rpartition("_")
    if not half:
        raise AttributeError(name)
    if service:
        return getattr(getattr(import_module(f"{package}.srv"), service), half)
    return getattr(import_module(f"{package}.msg"), name)


def filled(kind: Any, values: list[Any]) -> Any:
    message = kind()
    for field, slot, value in zip(
        kind.get_fields_and_field_types(), kind.SLOT_TYPES, values, strict=True
    ):
        setattr(message, field, as_ros_has_it(slot, value))
    return message


def as_ros_has_it(slot: Any, value: Any) -> Any:
    if isinstance(slot, AbstractNestedType):
        return [as_ros_has_it(slot.value_type, one) for one in value]
    if isinstance(slot, NamespacedType):
        return filled(message_class(*slot.namespaced_name()), value)
    if isinstance(slot, BasicType) and slot.typename == "octet":
        return bytes([value])
    return value


def by_definition(ros_type: str, definition: str, ours: bytes) -> dict[str, object]:
    """A stand-in for a package that is not on PyPI: another codec of ROS's encoding."""
    name = ros_type.replace("/msg/", "/")
    message = generate_dynamic(name, definition)[name](ours)
    again = serialize_dynamic(name, definition)[name](message)
    return {"by": "mcap_ros2", "bytes": again.hex(), "read_alike": True}


main()
