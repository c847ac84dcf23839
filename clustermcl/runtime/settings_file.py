"""Reads settings from a TOML file and from ``section.key=value`` on a command line."""

import difflib
import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import msgspec

from clustermcl.protocol.conversion import converted
from clustermcl.protocol.errors import InputFileError, SettingsError
from clustermcl.runtime.compressed import read_decompressed
from clustermcl.runtime.settings import Settings
from clustermcl.runtime.settings_table import TABLE, SettingInfo

_SECTIONS = sorted({name.partition(".")[0] for name in TABLE if "." in name})

_COMMAND_LINE = "--set"

MAX_FILE_BYTES = 2**18
"""Sixteen times a file with all settings and their descriptions."""
MAX_LINE_CHARACTERS = 1_000
"""The time of tomllib grows with the square of a dotted key's length."""

_LARGEST = 2**63 - 1
"""Settings are sent in messages, whose integers have 64 bits."""


def load_settings(
    path: Path | None,
    assignments: Sequence[str],
    *,
    beneath: Mapping[str, Any] = MappingProxyType({}),
    beneath_from: str = "",
) -> Settings:
    """Read the settings: the file overrides defaults, assignments override the file.

    Args:
        assignments: ``section.key=value``, the value as in TOML; text needs no quotes.
        beneath: values by dotted name that replace defaults; `beneath_from` names their origin.

    Raises:
        InputFileError: the file cannot be read or is not TOML.
        SettingsError: a setting is unknown, of the wrong type or out of its range.
    """
    given = {name: (value, beneath_from) for name, value in beneath.items()}
    if path is not None:
        given |= {name: (value, str(path)) for name, value in _read(path).items()}
    given |= {name: (value, _COMMAND_LINE) for name, value in _parsed(assignments).items()}
    settings = Settings()
    for name, (value, where) in given.items():
        settings = with_setting(settings, name, value, where)
    return settings


def with_setting(settings: Settings, name: str, value: object, where: str) -> Settings:
    """Return the settings with one value replaced; `SettingsError`s as of `load_settings`."""
    _check_known(name, where)
    section, _, key = name.rpartition(".")
    changed = {key: _converted(TABLE[name], value, where)}
    if section:
        changed = {section: msgspec.structs.replace(getattr(settings, section), **changed)}
    return msgspec.structs.replace(settings, **changed)


def _read(path: Path) -> dict[str, Any]:
    """Return all values of the file by dotted name."""
    content = read_decompressed(path, InputFileError, MAX_FILE_BYTES)
    try:
        text = content.decode()
        for number, written in enumerate(text.split("\n"), 1):
            if len(written) > MAX_LINE_CHARACTERS:
                problem = f"a line of {len(written)} characters"
                most = f"at most {MAX_LINE_CHARACTERS} are read"
                raise InputFileError(path, f"{problem}; {most}", line=number)
        tables = tomllib.loads(text)
    except UnicodeDecodeError as error:
        raise InputFileError(path, "not TOML: not UTF-8 text") from error
    except tomllib.TOMLDecodeError as error:
        place = re.search(r" \(at line (\d+), column \d+\)", str(error))
        problem = str(error).replace(place[0], "") if place else str(error)
        line = int(place[1]) if place else None
        raise InputFileError(path, f"not TOML: {problem}", line=line) from error
    except (ValueError, RecursionError) as error:  # a number too long, nesting too deep
        raise InputFileError(path, f"not TOML: {error}") from error
    leaves: dict[str, Any] = {}
    for name, value in tables.items():
        if isinstance(value, dict):
            leaves |= {f"{name}.{key}": leaf for key, leaf in value.items()}
        else:
            leaves[name] = value
    return leaves


def _parsed(assignments: Sequence[str]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for assignment in assignments:
        name, equals, text = (part.strip() for part in assignment.partition("="))
        if not equals or not name:
            raise SettingsError(f"{_COMMAND_LINE} {assignment!r}: write section.key=value")
        _check_known(name, _COMMAND_LINE)
        values[name] = text
        with suppress(ValueError, RecursionError):  # a TOMLDecodeError is a ValueError
            parsed = tomllib.loads(f"value = {text}")
            is_text = TABLE[name].kind is str and not isinstance(parsed["value"], str)
            if len(parsed) == 1 and not is_text:
                values[name] = parsed["value"]
    return values


def _check_known(name: str, where: str) -> None:
    if name in TABLE:
        return
    if name in _SECTIONS:
        problem = f"{name} is a section: give {name}.KEY"
        raise SettingsError(key=name, problem=problem, where=where)
    near = [setting for setting in TABLE if setting.endswith(f".{name.rpartition('.')[2]}")]
    if len(near) != 1:
        near = difflib.get_close_matches(name, near or list(TABLE), n=1)
    hint = f", did you mean {near[0]}?" if near else "; 'clustermcl settings --all' lists all"
    raise SettingsError(key=name, problem=f"unknown setting {name}{hint}", where=where)


def _converted(setting: SettingInfo, value: object, where: str) -> Any:
    """Have msgspec check a value; the error has the setting's name, the value and its type."""
    key = setting.name.rpartition(".")[2]
    if not isinstance(value, int | float) or abs(value) <= _LARGEST:  # NaN is not
        with suppress(msgspec.ValidationError):
            return getattr(converted({key: value}, setting.section), key)
    shown = repr(value)
    shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
    problem = f"{setting.name} = {shown}: expected {setting.expected}"
    raise SettingsError(key=setting.name, problem=problem, where=where)
