"""ROS's services for parameters."""

from typing import Any

import numpy as np

from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import new, response_of
from clustermcl.ros2.parameter_table import PARAMETERS, Value
from clustermcl.ros2.port import Port

_NOT_SET = 0
_TYPES: dict[type, tuple[int, str]] = {
    bool: (1, "bool_value"),
    int: (2, "integer_value"),
    float: (3, "double_value"),
    str: (4, "string_value"),
}
"""ROS's number of each type, and the field of a `ParameterValue` that holds it."""
_FIELDS = dict(_TYPES.values())


class ParameterServices:
    """Answers the services; `set...` also return the parameters that were set."""

    def __init__(self, port: Port) -> None:
        self._port = port

    def get(self, request: Any) -> Any:
        """Answer `GetParameters`: an unknown parameter is not set."""
        values = [self._value(name) for name in request.names]
        return new(response_of(types.GET_PARAMETERS), values=values)

    def kinds(self, request: Any) -> Any:
        numbers = np.array([self._value(name).type for name in request.names], np.uint8)
        return new(response_of(types.GET_PARAMETER_TYPES), types=numbers)

    def names(self, request: Any) -> Any:
        found = [name for name in PARAMETERS if _is_listed(name, request.prefixes, request.depth)]
        prefixes = {name.rpartition(".")[0] for name in found} - {""}
        listed = new(
            "rcl_interfaces/msg/ListParametersResult", names=found, prefixes=sorted(prefixes)
        )
        return new(response_of(types.LIST_PARAMETERS), result=listed)

    def describe(self, request: Any) -> Any:
        descriptors = [
            new(
                "rcl_interfaces/msg/ParameterDescriptor",
                name=name,
                type=self._value(name).type,
                description=parameter.description if parameter else "",
                read_only=parameter is not None and not parameter.is_live,
            )
            for name, parameter in ((name, PARAMETERS.get(name)) for name in request.names)
        ]
        return new(response_of(types.DESCRIBE_PARAMETERS), descriptors=descriptors)

    def set(self, request: Any) -> tuple[Any, list[Any]]:
        """Answer `SetParameters`: the invalid ones are refused with reasons."""
        results = [self._set([wanted]) for wanted in request.parameters]
        both = zip(request.parameters, results, strict=True)
        taken = [wanted for wanted, result in both if result.successful]
        return new(response_of(types.SET_PARAMETERS), results=results), taken

    def set_atomically(self, request: Any) -> tuple[Any, list[Any]]:
        """Answer `SetParametersAtomically`: all, or nothing."""
        result = self._set(request.parameters)
        taken = request.parameters if result.successful else []
        return new(response_of(types.SET_PARAMETERS_ATOMICALLY), result=result), taken

    def present(self, names: list[str]) -> list[Any]:
        """Return parameters as `Parameter` messages."""
        kind = "rcl_interfaces/msg/Parameter"
        return [new(kind, name=name, value=self._value(name)) for name in names]

    def _set(self, wanted: list[Any]) -> Any:
        values = {
            one.name: getattr(one.value, _FIELDS[one.value.type])
            if one.value.type in _FIELDS
            else None
            for one in wanted
        }
        reason = self._port.set_parameters(values)
        return new("rcl_interfaces/msg/SetParametersResult", successful=not reason, reason=reason)

    def _value(self, name: str) -> Any:
        parameter = PARAMETERS.get(name)
        if parameter is None:
            return new("rcl_interfaces/msg/ParameterValue", type=_NOT_SET)
        value: Value = parameter.value(self._port.parameters.settings)
        number, field = _TYPES[type(value)]
        return new("rcl_interfaces/msg/ParameterValue", type=number, **{field: value})


def _is_listed(name: str, prefixes: list[str], depth: int) -> bool:
    for prefix in prefixes or [""]:
        start = f"{prefix}." if prefix else ""
        if name == prefix or name.startswith(start):
            levels = name.removeprefix(start).count(".") + 1
            if depth == 0 or levels <= depth:
                return True
    return False
