"""ROS's own classes of messages and services, by their full names."""

from functools import cache
from importlib import import_module
from typing import Any


@cache
def class_of(ros_type: str) -> Any:
    """Return the class of a message or a service, such as `std_msgs/msg/String`, or of a half of
    a service, such as `std_srvs/msg/Empty_Response`."""
    package, kind, name = ros_type.split("/")
    name, _, half = name.partition("_")
    found = getattr(import_module(f"{package}.{'srv' if half else kind}"), name)
    return getattr(found, half) if half else found


def new(ros_type: str, fields: dict[str, Any]) -> Any:
    """Create a message; octets, which are `bytes` in rclpy, are given as numbers."""
    kind = class_of(ros_type)
    for name, of in kind.get_fields_and_field_types().items():
        if of == "octet" and name in fields:
            fields[name] = bytes((fields[name],))
    return kind(**fields)
