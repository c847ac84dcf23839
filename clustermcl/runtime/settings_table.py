"""Table of all settings by dotted name: type, bounds, default, unit, meaning; and as TOML."""

import ast
import inspect
import json
import textwrap
from collections.abc import Container, Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, Literal, get_args, get_origin

import msgspec

from clustermcl.filter.settings import FilterSettings
from clustermcl.protocol.keys import name_rule
from clustermcl.runtime.settings import Settings

_KINDS = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


@dataclass(frozen=True)
class SettingInfo:
    """Name, type, bounds and meaning of one setting."""

    name: str
    """``section.key``, or ``key`` alone at the top."""
    section: type[msgspec.Struct]
    kind: type
    """bool, int, float or str."""
    expected: str
    """Type and bounds in words."""
    default: bool | int | float | str

    @property
    def meaning(self) -> str:
        """The text below the setting in its section, with the unit in brackets."""
        return _texts(self.section)[self.name.rpartition(".")[2]]


EVERYDAY = frozenset({
    "seed", "robot.name", "log.level", "worker.count", "worker.cache_folder",
    "zenoh.router", "zenoh.start_router",
    "zenoh.tls_ca_certificate", "zenoh.tls_certificate", "zenoh.tls_private_key",
    "bridge.map", "bridge.source", "bridge.gate_distance_m", "bridge.gate_turn_rad",
    "bridge.laser_x_m", "bridge.laser_y_m", "bridge.laser_heading_rad",
    "motion.model", "motion.turn_noise_per_turn", "motion.turn_noise_per_metre",
    "motion.drive_noise_per_metre", "motion.drive_noise_per_turn", "motion.strafe_noise_per_metre",
    "sensor.max_beams", "sensor.max_range_m", "sensor.hit_sigma_m",
    "cluster.particles", "belief.max_clusters", "belief.particles",
    "belief.localized_probability", "belief.set_pose_probability",
    "coordinator.standby", "coordinator.stale_after_s", "coordinator.state_folder",
    "coordinator.keep_pose_on_new_map", "metrics.port", "metrics.host",
    "recorder.folder", "recorder.max_mb",
    "ros2.publish",
})  # fmt: skip
"""What an operator sets. The others are constants of the filter and of the service."""


def settings_as_toml(settings: Settings, names: Container[str] | None = None) -> str:
    """Write settings, each below its meaning, unit, range and default, as a settings file.

    With `names`, only these are written, and those that differ from their defaults.
    """
    sections: dict[str, list[str]] = {}
    for info in TABLE.values():
        is_default = value_of(settings, info.name) == info.default
        if names is not None and info.name not in names and is_default:
            continue
        section, _, key = info.name.rpartition(".")
        comment = f"{info.meaning}; {info.expected}; default {_toml(info.default)}"
        lines = sections.setdefault(section, [f"[{section}]"] if section else [])
        lines += textwrap.wrap(comment, 96, initial_indent="# ", subsequent_indent="#   ")
        lines.append(f"{key} = {_toml(value_of(settings, info.name))}")
    return "\n\n".join(map("\n".join, sections.values())) + "\n"


def value_of(settings: Settings, name: str) -> bool | int | float | str:
    value: bool | int | float | str = attrgetter(name)(settings)
    return value


@cache
def _texts(section: type) -> dict[str, str]:
    """Return the text below each field of a class."""
    (tree,) = ast.parse(inspect.getsource(section)).body
    assert isinstance(tree, ast.ClassDef)
    return {
        ast.unparse(field.target): " ".join(ast.literal_eval(text.value).split()).rstrip(".")
        for field, text in pairwise(tree.body)
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr)
    }


def _table() -> Iterator[SettingInfo]:
    """Yield top-level settings first: in TOML they must precede the first section."""
    fields = msgspec.structs.fields(Settings)
    sections = [field for field in fields if isinstance(field.default, msgspec.Struct)]
    for field in fields:
        if field not in sections:
            yield _info(field.name, field, FilterSettings)
    for section in sections:
        for field in msgspec.structs.fields(section.type):
            yield _info(f"{section.name}.{field.name}", field, section.type)


def _info(
    name: str, field: msgspec.structs.FieldInfo, section: type[msgspec.Struct]
) -> SettingInfo:
    is_bounded = get_origin(field.type) is Annotated
    plain, meta = get_args(field.type) if is_bounded else (field.type, msgspec.Meta())
    choices = get_args(plain) if get_origin(plain) is Literal else ()
    kind = str if choices else plain
    bounds = [
        f"{sign} {bound:.12g}"
        for sign, bound in ((">", meta.gt), (">=", meta.ge), ("<", meta.lt), ("<=", meta.le))
        if bound is not None
    ]
    return SettingInfo(
        name=name,
        section=section,
        kind=kind,
        expected=" or ".join(map(_toml, choices))
        or (meta.pattern and name_rule())
        or f"{_KINDS[kind]} {' and '.join(bounds)}".rstrip(),
        default=field.default,
    )


def _toml(value: bool | int | float | str) -> str:
    """Return a TOML value; a JSON string is a TOML string except for the delete character."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return json.dumps(value) if isinstance(value, bool) else repr(value)


TABLE = MappingProxyType({info.name: info for info in _table()})
"""Every setting by its dotted name, in the order of the settings file."""
