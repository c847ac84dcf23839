"""All that a coordinator knows between two events, as bytes, but for particles and beams.

A checkpoint is what another coordinator needs to carry on, told again by the workers what it
leaves out. Here nobody can be asked, and not one wait may end otherwise: so it is every attribute
of every part, pickled. Reading makes objects of the named packages' classes and of nothing else.
"""

import io
import pickle
from collections import Counter, deque
from types import MappingProxyType
from typing import Any

import msgspec

from coordinator.coordinator import Coordinator
from coordinator.recorder.records import no_particles, without_beams
from protocol.steps import Scan
from protocol.work import Particles

OURS = ("coordinator", "protocol", "particle_filter", "process_runtime")
_CONTAINERS = {("collections", kind.__name__): kind for kind in (Counter, deque)}


def freeze(coordinator: Coordinator) -> bytes:
    """All that it knows."""
    buffer = io.BytesIO()
    _Pickler(buffer, protocol=5).dump(coordinator)
    return buffer.getvalue()


def thaw(data: bytes) -> Coordinator:
    """A coordinator that decides from here on just as the other one.

    Raises:
        ValueError: the bytes are no coordinator, or one of another version.
    """
    try:
        found = _Unpickler(io.BytesIO(data)).load()
    except Exception as error:  # noqa: BLE001 - broken pickles raise nearly anything
        raise ValueError(f"not a coordinator's snapshot: {error}") from None
    if not isinstance(found, Coordinator):
        raise ValueError("not a coordinator's snapshot")
    return found


def _made(kind: type[msgspec.Struct], *values: Any) -> msgspec.Struct:
    return kind(**dict(zip(kind.__struct_fields__, values, strict=True)))


class _Pickler(pickle.Pickler):
    def reducer_override(self, value: Any) -> Any:
        """How our structures are taken apart; leaves all else to pickle."""
        match value:
            case Particles():
                value = no_particles(value)
            case Scan():
                value = without_beams(value)
            case MappingProxyType():
                return dict, (), None, None, iter(value.items())
        if not isinstance(value, msgspec.Struct):
            return NotImplemented
        return _made, (type(value), *(getattr(value, name) for name in value.__struct_fields__))


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Classes of ours, and those containers that they are made of."""
        if (module, name) == (_made.__module__, _made.__name__):
            return _made
        if kind := _CONTAINERS.get((module, name)):
            return kind
        if module.partition(".")[0] in OURS:
            found = super().find_class(module, name)
            if isinstance(found, type) and found.__module__ == module:
                return found
        raise pickle.UnpicklingError(f"{module}.{name} is no part of a coordinator")
