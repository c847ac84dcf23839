"""User-defined models and recording readers, selected by the names in the settings.

An extension is registered by this process or installed as an entry point. Settings and messages
can select only among these names.
"""

from functools import cache
from typing import Any, Literal, TypeAlias

from clustermcl.filter.settings import user_models

Kind: TypeAlias = Literal["sensor_model", "motion_model", "recording_reader"]
"""Kind of an extension; its entry point is in the group ``clustermcl.KIND``. docs/library.md
has recipes."""


class _Extensions(dict[tuple[str, str], Any]):
    """Extensions by kind and name; an installed one is loaded when it is first used."""

    def __contains__(self, key: Any) -> bool:
        return super().__contains__(key) or key[1] in _installed(key[0])

    def __missing__(self, key: tuple[str, str]) -> Any:
        """Load it; `ValueError`: there is none, or its code cannot be imported."""
        kind, name = key
        if key not in self:
            known = ", ".join(names(kind)) or "none"
            raise ValueError(f"no {kind} {name!r} is installed; known: {known}")
        try:
            self[key] = _installed(kind)[name].load()
        except (ImportError, AttributeError) as error:
            raise ValueError(f"{kind} {name!r} cannot be loaded: {error}") from error
        return self[key]


extensions = _Extensions()
user_models.maps.insert(0, extensions)


def register(kind: Kind, name: str, extension: object) -> None:
    """Register an extension in this process; replace an earlier one with this name.

    Args:
        kind: kind of the extension.
        name: value of ``sensor.model`` or ``motion.model``; any name for a reader.
        extension: a `SensorModel` class; a function like `motion.model.move`; or a function
            of a path that returns `clustermcl.Reading`s, or None for a file of another format.
    """
    extensions[kind, name] = extension


def names(kind: str) -> list[str]:
    return [*(name for of, name in extensions if of == kind), *_installed(kind)]


@cache
def _installed(kind: str) -> dict[str, Any]:
    """Return entry points by name; finding them takes 10 ms, and the import 2.5 MB."""
    from importlib.metadata import entry_points  # noqa: PLC0415

    return {point.name: point for point in entry_points(group=f"clustermcl.{kind}")}
