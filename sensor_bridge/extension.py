"""What a source of its own kind adds to a bridge."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from protocol.steps import Scan
from zenoh_link.wire import Asked


def _nothing(_scan: Scan) -> None:
    pass


@dataclass(frozen=True)
class Extension:
    """Told of steps and of queries; all is called by the bridge's one loop."""

    on_step: Callable[[Scan], None] = _nothing
    """Told of every step as soon as it is out, once."""
    serves: Mapping[str, Callable[[Asked], None]] = field(default_factory=dict)
    """Keys besides the bridge's own, and who answers there."""
