"""Messages of sensors that wait for the transforms of their time, as in AMCL."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

from clustermcl.protocol.causes import Named
from clustermcl.protocol.steps import LaserReading, Observation
from clustermcl.recordings.transforms import TransformMissingError
from clustermcl.ros2.outputs import Refused

Converted: TypeAlias = LaserReading | Observation

_NOT_LOOKED_UP = TransformMissingError("arrived too late", cause="too many wait", may_come=False)


@dataclass(eq=False)
class _Waiting:
    what: str
    source: str
    convert: Callable[[], Converted]
    since_ns: int
    missing: TransformMissingError = _NOT_LOOKED_UP
    """Which transform was missing when it was last looked up."""


class TfQueue:
    """Queue of messages that are converted once their transforms are known."""

    def __init__(self) -> None:
        self._waiting: list[_Waiting] = []
        self._missing_since_ns: dict[str, int] = {}

    def clear(self) -> None:
        self._waiting.clear()

    def add(
        self, what: str, source: str, convert: Callable[[], Converted], now_ns: int, most: int
    ) -> Iterator[Refused]:
        """Queue a message; refuse the oldest of its source if more than `most` wait.

        `convert` returns its content, or raises a `ValueError` if it cannot be used. Refusals name
        the kind of the message in their causes, and the source in their texts.
        """
        self._waiting.append(_Waiting(what, source, convert, now_ns))
        of_source = [one for one in self._waiting if one.source == source]
        if len(of_source) > most:
            self._waiting.remove(of_source[0])
            yield self._without_transform(of_source[0], now_ns)

    def ready(self, now_ns: int, tolerance_s: float) -> Iterator[Converted | Refused]:
        """Remove messages whose transforms are known or late; yield contents and refusals."""
        waiting, self._waiting = self._waiting, []
        for one in waiting:
            try:
                yield one.convert()
                self._missing_since_ns.pop(one.source, None)
            except TransformMissingError as missing:
                one.missing = missing
                self._missing_since_ns.setdefault(one.source, one.since_ns)
                if missing.may_come and now_ns - one.since_ns < tolerance_s * 1e9:
                    self._waiting.append(one)
                else:
                    yield self._without_transform(one, now_ns)
            except ValueError as problem:
                yield Refused(Named(f"{one.what} refused"), f"{one.source}: {problem}")

    def _without_transform(self, one: _Waiting, now_ns: int) -> Refused:
        since_ns = self._missing_since_ns.get(one.source, one.since_ns)
        waited = f"waited for {(now_ns - since_ns) / 1e9:.1f} s"
        cause = Named(f"{one.what} without transform: {one.missing.cause}")
        return Refused(cause, f"{one.source}, {waited}: {one.missing}")
