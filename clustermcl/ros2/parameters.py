"""The node's parameters and ROS's services for them."""

from typing import Any

import msgspec
import numpy as np

from clustermcl.filter.settings import section_with
from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.live_settings import AS_STARTED, LiveSettings
from clustermcl.ros2 import message_types as types
from clustermcl.ros2.message_types import new, response_of
from clustermcl.ros2.parameter_table import LIVE_SECTIONS, PARAMETERS, Value
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting

_NOT_SET = 0
_TYPES: dict[type, tuple[int, str]] = {
    bool: (1, "bool_value"),
    int: (2, "integer_value"),
    float: (3, "double_value"),
    str: (4, "string_value"),
}
"""ROS's number of each type, and the field of a `ParameterValue` that holds it."""
_FIELDS = dict(_TYPES.values())


class Parameters:
    """The node's parameters: settings by nav2's names."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.live = AS_STARTED
        """Settings of other processes that were changed since the start."""

    def adopt(self, live: LiveSettings) -> None:
        """Take over live settings that were changed before this node started."""
        self.live = live
        changed = {name: section_with(getattr(self.settings, name), live) for name in LIVE_SECTIONS}
        self.settings = msgspec.structs.replace(self.settings, **changed)

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
        """Answer `SetParameters`, and return what was set; the rest is refused with reasons."""
        results = [self._set_all([wanted]) for wanted in request.parameters]
        both = zip(request.parameters, results, strict=True)
        taken = [wanted for wanted, result in both if result.successful]
        return new(response_of(types.SET_PARAMETERS), results=results), taken

    def set_atomically(self, request: Any) -> tuple[Any, list[Any]]:
        """Answer `SetParametersAtomically`, and return what was set: all, or nothing."""
        result = self._set_all(request.parameters)
        taken = request.parameters if result.successful else []
        return new(response_of(types.SET_PARAMETERS_ATOMICALLY), result=result), taken

    def replace(self, values: dict[str, Value]) -> list[Any]:
        """Set parameters to valid values; return them as `Parameter` messages."""
        for name, value in values.items():
            self.settings = with_setting(self.settings, PARAMETERS[name].setting, value, name)
        kind = "rcl_interfaces/msg/Parameter"
        return [new(kind, name=name, value=self._value(name)) for name in values]

    def _set_all(self, parameters: list[Any]) -> Any:
        """Set all parameters or, if one is invalid, none; return a `SetParametersResult`."""
        before, reason = (self.settings, self.live), ""
        try:
            for wanted in parameters:
                self._set(wanted.name, wanted.value)
        except (SettingsError, ValueError) as error:
            (self.settings, self.live), reason = before, str(error)
        return new("rcl_interfaces/msg/SetParametersResult", successful=not reason, reason=reason)

    def _set(self, name: str, wanted: Any) -> None:
        """Set one parameter, or raise a `SettingsError` or ValueError that says why not."""
        parameter = PARAMETERS.get(name)
        if parameter is None:
            raise ValueError(f"there is no parameter {name}")
        if wanted.type != self._value(name).type:
            raise ValueError(f"{name} is a {type(parameter.default).__name__}")
        value = getattr(wanted, _FIELDS[wanted.type])
        if value == parameter.value(self.settings) and not parameter.live_name:
            return
        if not parameter.is_live:
            raise ValueError(parameter.reason or f"{parameter.setting} is read only at the start")
        try:
            setting = parameter.converted(value)
        except ValueError as error:
            raise ValueError(f"{name} = {value}: {error}") from None
        self.settings = with_setting(self.settings, parameter.setting, setting, name)
        if parameter.live_name:
            self.live = msgspec.structs.replace(self.live, **{parameter.live_name: setting})

    def _value(self, name: str) -> Any:
        parameter = PARAMETERS.get(name)
        if parameter is None:
            return new("rcl_interfaces/msg/ParameterValue", type=_NOT_SET)
        value: Value = parameter.value(self.settings)
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
