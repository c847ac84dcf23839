"""User-defined models and recording readers, selected by the names in the settings.

An extension is registered by this process or installed as an entry point. Settings and messages
can select only among these names.
"""

from functools import cache
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Kind: TypeAlias = Literal["sensor_model", "motion_model", "recording_reader"]
"""Kind of an extension; its entry point is in the group ``clustermcl.KIND``. docs/extending.md
has recipes."""

_registered: dict[tuple[Kind, str], Any] = {}


def register(kind: Kind, name: str, extension: object) -> None:
    """Register an extension in this process; replace an earlier one with this name.

    Args:
        kind: kind of the extension.
        name: value of ``sensor.model`` or ``motion.model``; any name for a reader.
        extension: a `SensorModel` class; a function like `motion.move_with_noise`; or a function
            of a path that returns `clustermcl.Reading`s, or None for a file of another format.
    """
    _registered[kind, name] = extension


def names(kind: Kind) -> list[str]:
    return [*(name for of, name in _registered if of == kind), *_installed(kind)]


def extension(kind: Kind, name: str) -> Any:
    """Return the extension with this name.

    Raises:
        ValueError: there is none, or its code cannot be imported.
    """
    if (kind, name) not in _registered:
        if name not in _installed(kind):
            known = ", ".join(names(kind)) or "none"
            raise ValueError(f"no {kind} {name!r} is installed; known: {known}")
        try:
            register(kind, name, _installed(kind)[name].load())
        except (ImportError, AttributeError) as error:
            raise ValueError(f"{kind} {name!r} cannot be loaded: {error}") from error
    return _registered[kind, name]


@cache
def _installed(kind: Kind) -> "dict[str, EntryPoint]":
    """Return entry points by name; finding them takes 10 ms, and the import 2.5 MB."""
    from importlib.metadata import entry_points  # noqa: PLC0415

    return {point.name: point for point in entry_points(group=f"clustermcl.{kind}")}
