"""Messages of sensors that wait for the transforms of their time, as in AMCL."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

from clustermcl.protocol.causes import AnyCause, Named
from clustermcl.protocol.steps import LaserReading, Observation
from clustermcl.recordings.transforms import TransformMissingError

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
    """Queue of messages that are converted once their transforms are known.

    `refuse` is called with the cause and the text of each that cannot be used.
    """

    def __init__(self, refuse: Callable[[AnyCause, str], object]) -> None:
        self._refuse = refuse
        self._waiting: list[_Waiting] = []

    def clear(self) -> None:
        self._waiting.clear()

    def add(
        self, what: str, source: str, convert: Callable[[], Converted], now_ns: int, most: int
    ) -> None:
        """Queue a message; refuse the oldest of its source if more than `most` wait.

        `convert` returns its content, or raises a `ValueError` if it cannot be used. Refusals name
        the kind of the message in their causes, and the source in their texts.
        """
        self._waiting.append(_Waiting(what, source, convert, now_ns))
        of_source = [one for one in self._waiting if one.source == source]
        if len(of_source) > most:
            self._waiting.remove(of_source[0])
            self._refuse_late(of_source[0])

    def ready(self, now_ns: int, tolerance_s: float) -> Iterator[Converted]:
        """Remove messages whose transforms are known or late; yield contents, refuse the others."""
        waiting, self._waiting = self._waiting, []
        for one in waiting:
            try:
                yield one.convert()
            except TransformMissingError as missing:
                one.missing = missing
                if missing.may_come and now_ns - one.since_ns < tolerance_s * 1e9:
                    self._waiting.append(one)
                else:
                    self._refuse_late(one)
            except ValueError as problem:
                self._refuse(Named(f"{one.what} refused"), f"{one.source}: {problem}")

    def _refuse_late(self, one: _Waiting) -> None:
        cause = Named(f"{one.what} without transform: {one.missing.cause}")
        self._refuse(cause, f"{one.source}: {one.missing}")
