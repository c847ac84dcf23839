"""The node's parameters: settings by nav2's names, changed all at once or not at all."""

from collections.abc import Mapping

import msgspec

from clustermcl.protocol.errors import SettingsError
from clustermcl.protocol.live_settings import AS_STARTED
from clustermcl.ros2.parameter_table import PARAMETERS, Value
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_file import with_setting


class Parameters:
    """The node's parameters.

    Attributes:
        settings: all settings, with the parameters' present values.
        live: settings of the engine that were changed since the start.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings, self.live = settings, AS_STARTED

    def replace(self, values: Mapping[str, Value], initial_floor: str) -> None:
        named = {PARAMETERS[name].setting: value for name, value in values.items()}
        for setting, value in (named | {"ros2.initial_floor": initial_floor}).items():
            self.settings = with_setting(self.settings, setting, value, setting)

    def set(self, values: Mapping[str, object]) -> str:
        before = self.settings, self.live
        try:
            for name, value in values.items():
                self._set(name, value)
        except (SettingsError, ValueError) as error:
            self.settings, self.live = before
            return str(error)
        return ""

    def _set(self, name: str, value: object) -> None:
        parameter = PARAMETERS[name]
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
