"""The base of the parts of a coordinator's state, which are encoded as a tree."""

from typing import Annotated, Any, ClassVar, TypeAlias

import msgspec
from msgspec import Meta

MAX_ITEMS = 2_000
"""Largest number of clusters, jobs, places or causes: fifty times a large robot's."""
Count: TypeAlias = Annotated[int, Meta(ge=0, lt=2**52)]
"""A number that a coordinator increases; at most half of the highest number in a message."""
Text: TypeAlias = Annotated[str, Meta(max_length=500)]
"""A name, or the cause of a counter."""
LogProbability: TypeAlias = Annotated[float, Meta(le=1e-6)]
"""Logarithm of a probability, with room for rounding; negative infinity: impossible."""
FEW = Meta(max_length=MAX_ITEMS)
"""Limits a list or a map."""


class Part(msgspec.Struct, forbid_unknown_fields=True):
    """A part of the state, with its settings and all that changes as fields."""

    local: ClassVar[frozenset[str]] = frozenset()
    """Fields that are not transferred: settings, times by the own clock, and data that a successor
    receives again."""


def handed_on(value: Any) -> Any:
    """Return a part without its local fields, as nested maps that decode to the same type."""
    match value:
        case Part():
            names = (name for name in value.__struct_fields__ if name not in value.local)
            return {name: handed_on(getattr(value, name)) for name in names}
        case dict():
            return {key: handed_on(item) for key, item in value.items()}
        case _:
            return value
