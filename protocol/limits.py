"""How large a message may be: what is larger is refused before it is decoded, or even copied."""

from collections.abc import Mapping
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any, get_args

from protocol import keys
from protocol.answers import (
    Belief,
    Configure,
    Drive,
    Hypotheses,
    Kidnap,
    Relocalize,
    SetPose,
    Status,
    Update,
)
from protocol.errors import MalformedMessageError
from protocol.job_events import JobEvents
from protocol.keys import WorkerKey, WorkerTopic
from protocol.sizes import LARGEST_BYTES, LIST_BYTES, SCAN_BYTES, SMALL_BYTES
from protocol.steps import LaserReading, MapMessage, MapReading, OdometryReading, Scan, ScanHistory
from protocol.work import Checkpoint, Report, SearchReport, TrackReport, WorkerState, WorkOrder

_BYTES: Mapping[Any, int] = MappingProxyType(
    dict.fromkeys((LaserReading, Scan), SCAN_BYTES)
    | dict.fromkeys((Belief, Hypotheses, JobEvents, Status), LIST_BYTES)
    | dict.fromkeys((MapMessage, MapReading, ScanHistory, TrackReport, SearchReport), LARGEST_BYTES)
    | dict.fromkeys((WorkOrder, WorkerState, Checkpoint), LARGEST_BYTES)
)


@cache
def max_bytes(expected: Any) -> int:
    """The most bytes that a message may have.

    Args:
        expected: a message class, or a union of them.
    """
    return max(_BYTES.get(kind, SMALL_BYTES) for kind in get_args(expected) or (expected,))


_ON_KEY: Mapping[str, Any] = MappingProxyType(
    {
        keys.ODOMETRY_READING: OdometryReading,
        keys.LASER_READING: LaserReading,
        keys.MAP_READING: MapReading,
        keys.SCAN: Scan,
        keys.ODOMETRY: OdometryReading,
        keys.BELIEF: Belief,
        keys.EVENTS: JobEvents,
        keys.CHECKPOINT: Checkpoint,
        keys.SET_POSE: SetPose,
        keys.RELOCALIZE: Relocalize,
        keys.KIDNAP: Kidnap,
        keys.UPDATE: Update,
        keys.CONFIGURE: Configure,
        keys.DRIVE: Drive,
        WorkerTopic.ORDER: WorkOrder,
        WorkerTopic.REPORT: Report,
    }
)
"""What is published or asked; elsewhere it is small, or nothing."""


@lru_cache(maxsize=1024)
def max_bytes_on(key: str) -> int:
    """The most bytes that a message on a key, or the payload of a query there, may have.

    What is larger is refused before it is copied, let alone decoded.
    """
    try:
        parsed = keys.parsed(key)
    except MalformedMessageError:
        return SMALL_BYTES  # of an extension
    return max_bytes(_ON_KEY.get(parsed.topic if isinstance(parsed, WorkerKey) else parsed))
