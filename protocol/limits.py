"""Size limits of messages by key; a larger one is refused before it is copied or decoded."""

from collections.abc import Mapping
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any, get_args

from protocol import keys
from protocol.answers import Belief
from protocol.errors import MalformedMessageError
from protocol.job_events import JobEvents
from protocol.keys import WorkerKey, WorkerTopic
from protocol.message import SMALL_BYTES, Message
from protocol.steps import LaserReading, MapReading, Scan
from protocol.work import Checkpoint, Reported, WorkOrder

_ON_KEY: Mapping[str, Any] = MappingProxyType(
    {
        keys.LASER_READING: LaserReading,
        keys.MAP_READING: MapReading,
        keys.SCAN: Scan,
        keys.BELIEF: Belief,
        keys.EVENTS: JobEvents,
        keys.CHECKPOINT: Checkpoint,
        WorkerTopic.ORDER: WorkOrder,
        WorkerTopic.REPORT: Reported,
    }
)
"""Large messages published or queried on each key; those on other keys are small or empty."""


@cache
def max_bytes(expected: Any) -> int:
    """Return the size limit of a message class or a union of message classes [bytes]."""
    kinds: tuple[type[Message], ...] = get_args(expected) or (expected,)
    return max(kind.max_bytes for kind in kinds)


@lru_cache(maxsize=1024)
def max_bytes_on(key: str) -> int:
    """Return the size limit of a message, or of a query's payload, on a key [bytes]."""
    try:
        parsed = keys.parsed(key)
    except MalformedMessageError:
        return SMALL_BYTES  # the key of an extension
    large = _ON_KEY.get(parsed.topic if isinstance(parsed, WorkerKey) else parsed)
    return max_bytes(large) if large else SMALL_BYTES
