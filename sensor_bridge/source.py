"""Where a bridge takes readings from when no robot publishes them, and what that adds to it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from protocol.steps import Reading, Scan
from zenoh_link.wire import Asked


class Source(Protocol):
    """Where readings come from when no robot publishes them."""

    steps: int | None
    """How many steps it makes; None: it does not end by itself."""

    def next_reading(self) -> Reading | None:
        """The next reading in the order of time; None at the end."""


def _nothing(_scan: Scan) -> None:
    pass


@dataclass(frozen=True)
class Extension:
    """Told of steps and of queries; all is called by the bridge's one loop."""

    on_step: Callable[[Scan], None] = _nothing
    """Told of every step as soon as it is out, once."""
    serves: Mapping[str, Callable[[Asked], None]] = field(default_factory=dict)
    """Keys besides the bridge's own, and who answers there."""
