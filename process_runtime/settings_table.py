"""All settings by dotted name: type, bounds, default, unit and meaning; and all as TOML."""

import json
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from operator import attrgetter
from types import MappingProxyType
from typing import Any, Literal, get_args, get_origin

import msgspec

from process_runtime.settings import Settings
from protocol.names import name_rule

_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


@dataclass(frozen=True)
class SettingInfo:
    """One setting."""

    name: str
    """``section.key``, or ``key`` alone at the top."""
    checked_type: Any
    """What `msgspec.convert` checks a value against."""
    kind: type
    """bool, int, float or str."""
    expected: str
    """Type and bounds in words."""
    default: bool | int | float | str
    unit: str
    meaning: str


def settings_as_toml(settings: Settings) -> str:
    """Write all settings, each below its meaning, unit, range and default, as a settings file."""
    sections: dict[str, list[str]] = {}
    for info in TABLE.values():
        section, _, key = info.name.rpartition(".")
        unit = f" [{info.unit}]" if info.unit else ""
        comment = f"{info.meaning}{unit}; {info.expected}; default {_toml(info.default)}"
        lines = sections.setdefault(section, [])
        lines += textwrap.wrap(comment, 96, initial_indent="# ", subsequent_indent="#   ")
        lines.append(f"{key} = {_toml(value_of(settings, info.name))}")
    return (
        "\n\n".join(
            "\n".join([f"[{section}]", *lines] if section else lines)
            for section, lines in sections.items()
        )
        + "\n"
    )


def value_of(settings: Settings, name: str) -> bool | int | float | str:
    """A setting by its dotted name."""
    value: bool | int | float | str = attrgetter(name)(settings)
    return value


def _table() -> Iterator[SettingInfo]:
    """Top-level settings first: in TOML they must stand before the first section."""
    fields = msgspec.structs.fields(Settings)
    sections = [field for field in fields if isinstance(field.default, msgspec.Struct)]
    for field in fields:
        if field not in sections:
            yield _info(field.name, field)
    for section in sections:
        for field in msgspec.structs.fields(section.type):
            yield _info(f"{section.name}.{field.name}", field)


def _info(name: str, field: msgspec.structs.FieldInfo) -> SettingInfo:
    plain, meta = get_args(field.type)
    choices = get_args(plain) if get_origin(plain) is Literal else ()
    kind = str if choices else plain
    bounds = [
        f"{sign} {bound:.12g}"
        for sign, bound in ((">", meta.gt), (">=", meta.ge), ("<", meta.lt), ("<=", meta.le))
        if bound is not None
    ]
    return SettingInfo(
        name=name,
        checked_type=field.type,
        kind=kind,
        expected=" or ".join(map(_toml, choices))
        or meta.extra["form"]
        or (meta.pattern and name_rule())
        or f"{_KINDS[kind]} {' and '.join(bounds)}".rstrip(),
        default=field.default,
        unit=meta.extra["unit"],
        meaning=meta.description,
    )


def _toml(value: bool | int | float | str) -> str:
    """A TOML value; JSON's text is TOML's, but for the delete character."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool) else repr(value)


TABLE = MappingProxyType({info.name: info for info in _table()})
"""Every setting by its dotted name, in the order of the settings file."""
