"""The parts of a coordinator's state: each is a tree whose encoding is all that it holds."""

from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar

import msgspec
from msgspec import Meta

MAX_ITEMS = 2_000
"""Clusters, jobs, places or causes: fifty times those of the largest robot known."""
Count: TypeAlias = Annotated[int, Meta(ge=0, lt=2**52)]
"""A number that a coordinator counts on from: half of what a message may contain."""
Text: TypeAlias = Annotated[str, Meta(max_length=500)]
"""A name, or the cause of a counter."""
LogProbability: TypeAlias = Annotated[float, Meta(le=1e-6)]
"""Logarithm of a probability, with room for rounding; negative infinity: impossible."""
FEW = Meta(max_length=MAX_ITEMS)
"""Limits a list or a map."""


class Part(msgspec.Struct, forbid_unknown_fields=True):
    """A part of the state: settings, and all that has changed since the start, as fields."""

    local: ClassVar[frozenset[str]] = frozenset()
    """Fields that stay with this coordinator: settings, times by its own clock, and what its
    successor receives again."""


def handed_on(value: Any) -> Any:
    """Return what a successor needs of a part, as maps that decode to the same type."""
    match value:
        case Part():
            names = (name for name in value.__struct_fields__ if name not in value.local)
            return {name: handed_on(getattr(value, name)) for name in names}
        case dict():
            return {key: handed_on(item) for key, item in value.items()}
        case _:
            return value


P = TypeVar("P", bound=Part)


def successor_of(part: P) -> P:
    """Return a part as another coordinator has it; local fields have their default values."""
    return msgspec.msgpack.decode(msgspec.msgpack.encode(handed_on(part)), type=type(part))
